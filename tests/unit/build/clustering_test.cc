#include "server/build/clustering.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "gtest/gtest.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

// Of costs of boxes in the unit cube, in float: squared distances that vanish are not seen as zero.
constexpr double kRounding = 1e-10;

struct Box {
  Bounds bounds;
  double count;
};

double CostOf(const Box& a, const Box& b, const ClusteringCost& cost) {
  double squared_distance = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const double gap = std::max({0.0, static_cast<double>(a.bounds.min[axis]) - b.bounds.max[axis],
                                 static_cast<double>(b.bounds.min[axis]) - a.bounds.max[axis]});
    squared_distance += gap * gap;
  }
  const double work = std::ceil((a.count + b.count) / cost.group_size()) * cost.group_size();
  return cost.area_weight() * Union(a.bounds, b.bounds).HalfArea() * work + cost.distance_weight() * squared_distance;
}

// Follows `dendrogram` and expects each of its merges to be of least cost among all pairs that are left, as far as
// float can tell.
void ExpectEachMergeIsCheapest(std::span<const Reference> references, const Dendrogram& dendrogram,
                               const ClusteringCost& cost) {
  ASSERT_EQ(dendrogram.size() + 1, references.size());
  std::vector<Box> clusters;
  std::vector<uint32_t> left_over;
  for (const Reference& reference : references) {
    left_over.push_back(static_cast<uint32_t>(clusters.size()));
    clusters.push_back({reference.bounds, 1});
  }
  for (const auto& [left, right] : dendrogram) {
    double least = std::numeric_limits<double>::infinity();
    for (const uint32_t a : left_over) {
      for (const uint32_t b : left_over) {
        if (a < b) least = std::min(least, CostOf(clusters[a], clusters[b], cost));
      }
    }
    EXPECT_NEAR(CostOf(clusters[left], clusters[right], cost), least, 1e-5 * least + kRounding);
    for (const uint32_t merged : {left, right}) {
      const auto place = std::find(left_over.begin(), left_over.end(), merged);
      ASSERT_NE(place, left_over.end()) << "merged twice";
      left_over.erase(place);
    }
    left_over.push_back(static_cast<uint32_t>(clusters.size()));
    clusters.push_back(
        {Union(clusters[left].bounds, clusters[right].bounds), clusters[left].count + clusters[right].count});
  }
}

class ClusteringAlphaTest : public testing::TestWithParam<double> {};

INSTANTIATE_TEST_SUITE_P(Alphas, ClusteringAlphaTest, testing::Values(0.0, 0.2, 0.6, 1.0));

TEST_P(ClusteringAlphaTest, EachMergeIsTheCheapest) {
  for (uint64_t seed = 0; seed < 8; ++seed) {
    // From far apart to all over each other.
    const std::vector<Reference> references = RandomReferences(60, seed, 0.01 * static_cast<double>(1 << seed));
    const ClusteringCost cost(GetParam(), Config(), UnionOf(references), 1.5);
    BuildContext context;
    ExpectEachMergeIsCheapest(references, Cluster(references, cost, context), cost);
  }
}

TEST_P(ClusteringAlphaTest, TiesAreBrokenAlways) {
  std::vector<Reference> references(40, RandomReferences(1, 1)[0]);
  const ClusteringCost cost(GetParam(), Config(), Bounds{{0, 0, 0}, {2, 2, 2}}, 1);
  BuildContext context;
  ExpectEachMergeIsCheapest(references, Cluster(references, cost, context), cost);
}

// Nested boxes all have the innermost one for a neighbour at first; copies all cost the same.
TEST_P(ClusteringAlphaTest, LargeDeltaLeavesTakeQuadraticTime) {
  std::vector<Reference> nested(2048), copies(2048, RandomReferences(1, 1)[0]);
  for (uint32_t i = 0; i < nested.size(); ++i) {
    const float size = static_cast<float>(i + 1);
    nested[i] = {{{-size, -size, -size}, {size, size, size}}, i};
  }
  BuildContext context;
  for (const auto& references : {nested, copies}) {
    const ClusteringCost cost(GetParam(), Config(), UnionOf(references), 1);
    EXPECT_EQ(Cluster(references, cost, context).size(), 2047u);
  }
}

TEST(ClusteringTest, OneReferenceIsOneCluster) {
  BuildContext context;
  const std::vector<Reference> one = RandomReferences(1, 1);
  EXPECT_TRUE(Cluster(one, ClusteringCost(0.6, Config(), UnionOf(one), 1), context).empty());
}

TEST(ClusteringTest, CostIsThatOfThePaper) {
  Config config;
  config.cluster_intersection_cost = 10;
  const Bounds all{{0, 0, 0}, {1, 1, 1}};  // half area 3
  const ClusteringCost cost(0.25, config, all, 2);
  EXPECT_DOUBLE_EQ(cost.area_weight(), 0.25 * 10 / 3);
  EXPECT_DOUBLE_EQ(cost.distance_weight(), 0.75 / 4);
  EXPECT_EQ(cost.group_size(), 8u);
  config.builder = Builder::kTang2015;
  EXPECT_EQ(ClusteringCost(0.25, config, all, 2).group_size(), 1u) << "as printed";
  EXPECT_EQ(ClusteringCost(1, config, all, 2).distance_weight(), 0);
  EXPECT_EQ(ClusteringCost(0, config, all, 2).area_weight(), 0);
}

TEST(ClusteringTest, EndsEarlyOnceCancelled) {
  BuildContext context;
  context.Cancel();
  const std::vector<Reference> references = RandomReferences(100, 1);
  EXPECT_TRUE(Cluster(references, ClusteringCost(0.6, Config(), UnionOf(references), 1), context).empty());
}

}  // namespace
}  // namespace deltaray
