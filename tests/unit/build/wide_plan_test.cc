#include "server/build/wide_plan.h"

#include <algorithm>
#include <map>
#include <utility>

#include "gtest/gtest.h"
#include "server/build/clustering.h"
#include "server/build/collapse.h"
#include "server/build/sweep_builder.h"
#include "server/tree/wide_node.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

// A binary tree over random boxes, one reference a leaf.
BvhArrays RandomTree(uint32_t references, uint64_t seed, double size) {
  BuildContext context;
  const std::vector<Reference> boxes = RandomReferences(references, seed, size);
  return CollapsedTree(boxes, SplitBySweeps(boxes, SahCosts(Config()), context), SahCosts(Config()), 1).ToBvhArrays();
}

uint32_t ReferencesBelow(const BvhArrays& tree, uint32_t node) {
  if (tree.nodes[node].IsLeaf()) return tree.nodes[node].count;
  return ReferencesBelow(tree, node + 1) + ReferencesBelow(tree, tree.nodes[node].offset);
}

// The cost of the subtree in the wide tree as planned; adds up the references of leaves.
double PlannedCost(const BvhArrays& tree, const WidePlan& plan, uint32_t node, uint32_t* references) {
  constexpr size_t kMostChildren = 16;
  const double half_area = tree.nodes[node].bounds.HalfArea();
  if (const uint32_t size = plan.LeafSize(node)) {
    EXPECT_LE(size, kMaxLeafTriangles);
    EXPECT_EQ(size, ReferencesBelow(tree, node));
    *references += size;
    return WidePlan::kLeafCost * half_area;
  }
  std::vector<uint32_t> children(kMostChildren);
  children.resize(plan.Children(node, children.data()));
  EXPECT_GE(children.size(), 2u);
  double cost = WidePlan::kNodeCost * half_area;
  for (const uint32_t child : children) cost += PlannedCost(tree, plan, child, references);
  return cost;
}

// The least cost of at most `roots` roots over a subtree, by trying everything.
class LeastWideCost {
 public:
  LeastWideCost(const BvhArrays& tree, int width) : tree_(tree), width_(width) {}

  double operator()(uint32_t node, int roots) {
    if (const auto known = costs_.find({node, roots}); known != costs_.end()) return known->second;
    const BvhNode& n = tree_.nodes[node];
    const double half_area = n.bounds.HalfArea();
    double least = std::numeric_limits<double>::infinity();
    if (ReferencesBelow(tree_, node) <= kMaxLeafTriangles) least = WidePlan::kLeafCost * half_area;
    if (!n.IsLeaf()) {
      if (roots == 1) least = std::min(least, WidePlan::kNodeCost * half_area + Shared(node, width_));
      if (roots > 1) least = std::min((*this)(node, roots - 1), Shared(node, roots));
    }
    return costs_[{node, roots}] = least;
  }

 private:
  double Shared(uint32_t node, int roots) {
    double least = std::numeric_limits<double>::infinity();
    for (int k = 1; k < roots; ++k) {
      least = std::min(least, (*this)(node + 1, k) + (*this)(tree_.nodes[node].offset, roots - k));
    }
    return least;
  }

  const BvhArrays& tree_;
  const int width_;
  std::map<std::pair<uint32_t, int>, double> costs_;
};

TEST(WidePlanTest, IsTheCheapestAndHoldsEveryReferenceOnce) {
  for (const int width : {4, 8, 16}) {
    for (const uint32_t references : {9u, 40u, 300u}) {
      for (const double size : {0.01, 0.3}) {
        SCOPED_TRACE(testing::Message() << width << " wide, " << references << " references of size " << size);
        const BvhArrays tree = RandomTree(references, references, size);
        BuildContext context;
        const WidePlan plan(tree.nodes, width, context);
        uint32_t planned = 0;
        const double cost = PlannedCost(tree, plan, 0, &planned);
        EXPECT_EQ(planned, references);
        const double least = LeastWideCost(tree, width)(0, 1);
        EXPECT_NEAR(cost, least, 1e-5 * least);
      }
    }
  }
}

TEST(WidePlanTest, FewReferencesAreOneLeaf) {
  const BvhArrays tree = RandomTree(8, 1, 1);
  BuildContext context;
  EXPECT_EQ(WidePlan(tree.nodes, 8, context).LeafSize(0), 8u);
}

TEST(WidePlanTest, BoxesWithoutAreaArePlannedToo) {
  std::vector<Reference> points(100);
  for (uint32_t i = 0; i < points.size(); ++i) points[i] = {{{1, 2, 3}, {1, 2, 3}}, i};
  BuildContext context;
  const BvhArrays tree =
      CollapsedTree(points, SplitBySweeps(points, SahCosts(Config()), context), SahCosts(Config()), 1).ToBvhArrays();
  for (const int width : {4, 8, 16}) {
    uint32_t planned = 0;
    EXPECT_EQ(PlannedCost(tree, WidePlan(tree.nodes, width, context), 0, &planned), 0);
    EXPECT_EQ(planned, 100u);
  }
}

}  // namespace
}  // namespace deltaray
