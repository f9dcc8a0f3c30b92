#include "server/build/sweep_builder.h"

#include <algorithm>
#include <limits>

#include "gtest/gtest.h"
#include "server/build/collapse.h"
#include "server/build/top_down.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

TEST(SweepBuilderTest, EveryClusterIsMergedOnce) {
  BuildContext context;
  for (const uint32_t count : {1, 2, 3, 100}) {
    const Dendrogram dendrogram = SplitBySweeps(RandomReferences(count, count), SahCosts(Config()), context);
    ASSERT_EQ(dendrogram.size(), count - 1);
    std::vector<int> merged(2 * count - 1, 0);
    for (size_t i = 0; i < dendrogram.size(); ++i) {
      for (const uint32_t child : {dendrogram[i].left, dendrogram[i].right}) {
        ASSERT_LT(child, count + i);
        ++merged[child];
      }
    }
    EXPECT_EQ(std::count(merged.begin(), merged.end(), 1), 2 * count - 2);
  }
}

// The least cost of all splits by order of centres, by trying each.
double LeastCost(std::vector<Reference> references, const SahCosts& costs) {
  double least = std::numeric_limits<double>::infinity();
  for (int axis = 0; axis < 3; ++axis) {
    std::sort(references.begin(), references.end(), [axis](const Reference& a, const Reference& b) {
      return a.bounds.DoubledCentre(axis) < b.bounds.DoubledCentre(axis);
    });
    for (uint32_t i = 1; i < references.size(); ++i) {
      const std::span<const Reference> all(references);
      least = std::min(
          least, UnionOf(all.first(i)).HalfArea() * costs.Work(i) +
                     UnionOf(all.subspan(i)).HalfArea() * costs.Work(static_cast<uint32_t>(references.size()) - i));
    }
  }
  return least;
}

// The references of each cluster.
std::vector<std::vector<Reference>> ClustersOf(const std::vector<Reference>& references, const Dendrogram& dendrogram) {
  std::vector<std::vector<Reference>> clusters;
  for (const Reference& reference : references) clusters.push_back({reference});
  for (const Merge& merge : dendrogram) {
    clusters.push_back(clusters[merge.left]);
    const std::vector<Reference>& right = clusters[merge.right];
    clusters.back().insert(clusters.back().end(), right.begin(), right.end());
  }
  return clusters;
}

TEST(SweepBuilderTest, EachSplitIsTheCheapest) {
  BuildContext context;
  for (const Builder builder : {Builder::kBvh, Builder::kHybrid}) {
    const SahCosts costs(MakeConfig(builder, Preset::kBalanced));
    for (uint64_t seed = 0; seed < 10; ++seed) {
      const std::vector<Reference> references = RandomReferences(2 + 15 * static_cast<uint32_t>(seed), seed);
      const Dendrogram dendrogram = SplitBySweeps(references, costs, context);
      const std::vector<std::vector<Reference>> clusters = ClustersOf(references, dendrogram);
      for (size_t i = 0; i < dendrogram.size(); ++i) {
        const auto& left = clusters[dendrogram[i].left];
        const auto& right = clusters[dendrogram[i].right];
        const double cost = UnionOf(left).HalfArea() * costs.Work(static_cast<uint32_t>(left.size())) +
                            UnionOf(right).HalfArea() * costs.Work(static_cast<uint32_t>(right.size()));
        EXPECT_LE(cost, 1.00001 * LeastCost(clusters[references.size() + i], costs));
      }
    }
  }
}

// All splits of copies cost the same; taking the first would peel off one at a time.
TEST(SweepBuilderTest, HalvesCopies) {
  const std::vector<Reference> copies(16, RandomReferences(1, 1)[0]);
  BuildContext context;
  const Dendrogram dendrogram = SplitBySweeps(copies, SahCosts(Config()), context);
  const auto clusters = ClustersOf(copies, dendrogram);
  EXPECT_EQ(clusters[dendrogram.back().left].size(), 8u);
}

TEST(SweepBuilderTest, PartsTwoHeaps) {
  std::vector<Reference> references = RandomReferences(16, 1);
  for (size_t i = 0; i < references.size(); i += 2) {
    references[i].bounds.min.x += 100;
    references[i].bounds.max.x += 100;
  }
  BuildContext context;
  const Dendrogram dendrogram = SplitBySweeps(references, SahCosts(Config()), context);
  const CollapsedTree tree(references, dendrogram, SahCosts(Config()), 1);
  const BvhArrays arrays = tree.ToBvhArrays();
  EXPECT_LT(arrays.nodes[1].bounds.max.x, 2);
  EXPECT_GE(arrays.nodes[arrays.nodes[0].offset].bounds.min.x, 100);
}

// Each box is twice as large as the one before: the cheapest split peels off one at a time.
TEST(SweepBuilderTest, DepthIsBounded) {
  std::vector<Reference> references(250);
  for (uint32_t i = 0; i < references.size(); ++i) {
    const float size = std::ldexp(1.0f, static_cast<int>(i) - 125);
    references[i] = {{{0, 0, 0}, {size, size, size}}, i};
  }
  BuildContext context;
  const Dendrogram dendrogram = SplitBySweeps(references, SahCosts(Config()), context);
  const CollapsedTree tree(references, dendrogram, SahCosts(Config()), 1);
  EXPECT_GT(tree.depth(), 32u);
  EXPECT_LE(tree.depth(), kMaxTopDownDepth);
}

}  // namespace
}  // namespace deltaray
