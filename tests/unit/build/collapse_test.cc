#include "server/build/collapse.h"

#include <algorithm>

#include "gtest/gtest.h"
#include "server/build/sweep_builder.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

SahCosts Costs(double traversal, double intersection) {
  Config config;
  config.traversal_cost = traversal;
  config.intersection_cost = intersection;
  return SahCosts(config);
}

// The SAH cost of a BVH as it stands.
double CostOf(const BvhArrays& arrays, const SahCosts& costs) {
  double cost = 0;
  for (const BvhNode& node : arrays.nodes) {
    cost += node.IsLeaf() ? costs.Leaf(node.bounds.HalfArea(), node.count) : costs.Split(node.bounds.HalfArea(), 0);
  }
  return cost;
}

// The least cost over all sets of leaves, by trying them.
double LeastCost(std::span<const Reference> references, const Dendrogram& dendrogram, size_t cluster,
                 const SahCosts& costs, uint32_t max_leaf_size, std::vector<Reference>* below) {
  if (cluster < references.size()) {
    *below = {references[cluster]};
    return costs.Leaf(references[cluster].bounds.HalfArea(), 1);
  }
  std::vector<Reference> right;
  const auto [left_id, right_id] = dendrogram[cluster - references.size()];
  double split = LeastCost(references, dendrogram, left_id, costs, max_leaf_size, below) +
                 LeastCost(references, dendrogram, right_id, costs, max_leaf_size, &right);
  below->insert(below->end(), right.begin(), right.end());
  const double half_area = UnionOf(*below).HalfArea();
  split += costs.traversal * half_area;
  if (below->size() > max_leaf_size) return split;
  return std::min(split, costs.Leaf(half_area, below->size()));
}

TEST(CollapseTest, CostIsTheLeastAndThatOfTheTree) {
  const std::vector<Reference> references = RandomReferences(100, 7, 0.5);
  BuildContext context;
  const Dendrogram dendrogram = SplitBySweeps(references, SahCosts(Config()), context);
  for (const SahCosts& costs : {Costs(1, 1), Costs(5, 1), Costs(1, 80)}) {
    for (const uint32_t max_leaf_size : {1, 4, 255}) {
      const CollapsedTree tree(references, dendrogram, costs, max_leaf_size);
      std::vector<Reference> below;
      const double least =
          LeastCost(references, dendrogram, references.size() + dendrogram.size() - 1, costs, max_leaf_size, &below);
      EXPECT_NEAR(tree.cost(), least, 1e-9 * least);
      EXPECT_NEAR(CostOf(tree.ToBvhArrays(), costs), least, 1e-9 * least);
    }
  }
}

TEST(CollapseTest, LeavesKeepToTheirSize) {
  const std::vector<Reference> references = RandomReferences(200, 3, 2);
  BuildContext context;
  const Dendrogram dendrogram = SplitBySweeps(references, SahCosts(Config()), context);
  for (const uint32_t max_leaf_size : {1, 3, 8}) {
    const BvhArrays arrays = CollapsedTree(references, dendrogram, Costs(10, 1), max_leaf_size).ToBvhArrays();
    uint32_t largest = 0;
    for (const BvhNode& node : arrays.nodes) largest = std::max(largest, node.count);
    EXPECT_EQ(largest, max_leaf_size);
    std::vector<uint32_t> primitives = arrays.references;
    std::sort(primitives.begin(), primitives.end());
    ASSERT_EQ(primitives.size(), 200u);
    for (uint32_t i = 0; i < 200; ++i) EXPECT_EQ(primitives[i], i);
  }
}

TEST(CollapseTest, NodesAreInDepthFirstOrder) {
  // ((0 1) (2 3)), apart enough that nothing collapses.
  std::vector<Reference> references;
  for (const float x : {0, 10, 100, 110}) {
    references.push_back({{{x, 0, 0}, {x + 1, 1, 1}}, static_cast<uint32_t>(x)});
  }
  const Dendrogram dendrogram{{0, 1}, {2, 3}, {4, 5}};
  const CollapsedTree tree(references, dendrogram, Costs(1, 1), 8);
  EXPECT_EQ(tree.depth(), 2u);
  const BvhArrays arrays = tree.ToBvhArrays();
  ASSERT_EQ(arrays.nodes.size(), 7u);
  EXPECT_EQ(arrays.nodes[0].offset, 4u);
  EXPECT_EQ(arrays.nodes[1].offset, 3u);
  EXPECT_EQ(arrays.nodes[4].offset, 6u);
  EXPECT_EQ(arrays.references, (std::vector<uint32_t>{0, 10, 100, 110}));
}

TEST(CollapseTest, OneReferenceIsALeaf) {
  const std::vector<Reference> one = RandomReferences(1, 1);
  const CollapsedTree tree(one, {}, Costs(1, 1), 8);
  EXPECT_EQ(tree.depth(), 0u);
  const BvhArrays arrays = tree.ToBvhArrays();
  ASSERT_EQ(arrays.nodes.size(), 1u);
  EXPECT_EQ(arrays.nodes[0].count, 1u);
  EXPECT_EQ(arrays.nodes[0].bounds, one[0].bounds);
}

}  // namespace
}  // namespace deltaray
