#include "server/build/object_split.h"

#include <algorithm>
#include <limits>

#include "gtest/gtest.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

// The least cost of all splits by order of centres, by trying each.
double LeastCost(std::vector<Reference> references) {
  double least = std::numeric_limits<double>::infinity();
  for (int axis = 0; axis < 3; ++axis) {
    std::sort(references.begin(), references.end(), [axis](const Reference& a, const Reference& b) {
      return a.bounds.DoubledCentre(axis) < b.bounds.DoubledCentre(axis);
    });
    for (size_t i = 1; i < references.size(); ++i) {
      const std::span<const Reference> all(references);
      least = std::min(least, UnionOf(all.first(i)).HalfArea() * static_cast<double>(i) +
                                  UnionOf(all.subspan(i)).HalfArea() * static_cast<double>(references.size() - i));
    }
  }
  return least;
}

// Partitions and compares what comes out with what the split says.
void ExpectSplits(std::vector<Reference> references, const ObjectSplit& split) {
  ASSERT_TRUE(split.IsFound());
  BuildContext context;
  const size_t left = Partition(references, split, context);
  ASSERT_GT(left, 0u);
  ASSERT_LT(left, references.size());
  const std::span<const Reference> all(references);
  EXPECT_EQ(UnionOf(all.first(left)), split.left);
  EXPECT_EQ(UnionOf(all.subspan(left)), split.right);
  const size_t right = references.size() - left;
  EXPECT_EQ(split.cost,
            split.left.HalfArea() * static_cast<double>(left) + split.right.HalfArea() * static_cast<double>(right));
}

// The split of a builder that counts references one by one.
ObjectSplit Find(std::span<const Reference> references) {
  BuildContext context;
  return FindObjectSplit(references, SumBounds(references, context),
                         SahCosts(MakeConfig(Builder::kBvh, Preset::kBalanced)), context);
}

std::vector<Reference> Copies(uint32_t count) {
  std::vector<Reference> references(count, {Bounds{{0, 0, 0}, {1, 1, 0}}, 0});
  for (uint32_t i = 0; i < count; ++i) references[i].primitive = i;
  return references;
}

TEST(ObjectSplitTest, BinsComeCloseToTheCheapest) {
  for (const uint32_t count : {3, 10, 50, 100, 200, 1000}) {
    const std::vector<Reference> references = RandomReferences(count, count);
    const ObjectSplit split = Find(references);
    ExpectSplits(references, split);
    EXPECT_LE(split.cost, 1.05 * LeastCost(references)) << count;
  }
}

// More than one task bins these.
TEST(ObjectSplitTest, ManyReferencesSplit) {
  const std::vector<Reference> references = RandomReferences(100'000, 3, 0.01);
  ExpectSplits(references, Find(references));
}

// Areas overflow float, and so do differences of coordinates; or the former vanish.
TEST(ObjectSplitTest, HugeAndTinyReferencesSplit) {
  for (const float size : {3e38f, 1e-30f}) {
    std::vector<Reference> references = RandomReferences(100, 1);
    for (Reference& reference : references) {
      for (int axis = 0; axis < 3; ++axis) {
        reference.bounds.min[axis] = size * std::min(2 * reference.bounds.min[axis] - 1, 1.0f);
        reference.bounds.max[axis] = size * std::min(2 * reference.bounds.max[axis] - 1, 1.0f);
      }
    }
    ExpectSplits(references, Find(references));
    EXPECT_LE(Find(references).cost, 1.05 * LeastCost(references)) << size;
  }
}

TEST(ObjectSplitTest, GroupsThatAreBegunCountAsFull) {
  // A row of ten boxes that are alike: halves are cheapest, but eight and two begin as few groups.
  std::vector<Reference> references = Copies(10);
  for (Reference& reference : references) {
    reference.bounds.min.x += static_cast<float>(2 * reference.primitive);
    reference.bounds.max.x += static_cast<float>(2 * reference.primitive);
  }
  BuildContext context;
  EXPECT_EQ(Partition(references, Find(references), context), 5u);
  const ObjectSplit split = FindObjectSplit(references, SumBounds(references, context), SahCosts(Config()), context);
  EXPECT_EQ(split.cost, 8 * (split.left.HalfArea() + split.right.HalfArea()));
}

TEST(ObjectSplitTest, OneReferenceDoesNotSplit) { EXPECT_FALSE(Find(RandomReferences(1, 1)).IsFound()); }

TEST(ObjectSplitTest, CopiesSplitOnlyInHalves) {
  std::vector<Reference> references = Copies(1001);
  EXPECT_FALSE(Find(references).IsFound());
  EXPECT_EQ(PartitionAtMedian(references, UnionOf(references)), 500u);
}

}  // namespace
}  // namespace deltaray
