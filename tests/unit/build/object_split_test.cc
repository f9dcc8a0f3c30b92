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
  EXPECT_EQ(split.cost, split.left.HalfArea() * static_cast<double>(left) +
                            split.right.HalfArea() * static_cast<double>(references.size() - left));
}

std::vector<Reference> Copies(uint32_t count) {
  std::vector<Reference> references(count, {Bounds{{0, 0, 0}, {1, 1, 0}}, 0});
  for (uint32_t i = 0; i < count; ++i) references[i].primitive = i;
  return references;
}

TEST(ObjectSplitTest, SweepFindsTheCheapest) {
  for (uint64_t seed = 0; seed < 20; ++seed) {
    const std::vector<Reference> references = RandomReferences(2 + static_cast<uint32_t>(seed) * 3, seed);
    const ObjectSplit split = SweepObjectSplit(references);
    EXPECT_EQ(split.cost, LeastCost(references)) << seed;
    ExpectSplits(references, split);
  }
}

TEST(ObjectSplitTest, FewReferencesAreSwept) {
  const std::vector<Reference> references = RandomReferences(32, 1);
  BuildContext context;
  EXPECT_EQ(FindObjectSplit(references, context).cost, LeastCost(references));
}

TEST(ObjectSplitTest, BinsComeCloseToTheCheapest) {
  for (const uint32_t count : {100, 1000}) {
    const std::vector<Reference> references = RandomReferences(count, count);
    BuildContext context;
    const ObjectSplit split = FindObjectSplit(references, context);
    ExpectSplits(references, split);
    EXPECT_LE(split.cost, 1.05 * LeastCost(references));
  }
}

// More than one task bins these.
TEST(ObjectSplitTest, ManyReferencesSplit) {
  const std::vector<Reference> references = RandomReferences(100'000, 3, 0.01);
  BuildContext context;
  ExpectSplits(references, FindObjectSplit(references, context));
}

TEST(ObjectSplitTest, OneReferenceDoesNotSplit) {
  BuildContext context;
  EXPECT_FALSE(FindObjectSplit(RandomReferences(1, 1), context).IsFound());
  EXPECT_FALSE(SweepObjectSplit({}).IsFound());
}

TEST(ObjectSplitTest, ManyCopiesSplitOnlyInHalves) {
  std::vector<Reference> references = Copies(1001);
  BuildContext context;
  EXPECT_FALSE(FindObjectSplit(references, context).IsFound());
  const ObjectSplit median = MedianSplit(references, UnionOf(references));
  ExpectSplits(references, median);
  EXPECT_EQ(Partition(references, median, context), 500u);
}

// All splits of copies cost the same; taking the first would peel off one at a time.
TEST(ObjectSplitTest, SweepHalvesCopies) {
  std::vector<Reference> references = Copies(16);
  const ObjectSplit split = SweepObjectSplit(references);
  BuildContext context;
  EXPECT_EQ(Partition(references, split, context), 8u);
}

}  // namespace
}  // namespace deltaray
