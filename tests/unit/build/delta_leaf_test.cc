#include "server/build/delta_leaf.h"

#include <algorithm>
#include <numeric>

#include "gtest/gtest.h"
#include "server/build/clustering.h"
#include "server/build/collapse.h"
#include "server/build/sweep_builder.h"
#include "server/build/top_down.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

// The cost of the subtree of `node`, whose leaves have one reference each, once leaves are made of its lower parts.
double CostOf(const BvhArrays& arrays, uint32_t node, uint32_t* references) {
  const SahCosts costs{Config()};
  const BvhNode& n = arrays.nodes[node];
  if (n.IsLeaf()) {
    *references = 1;
    return costs.Leaf(n.bounds.HalfArea(), 1);
  }
  uint32_t left = 0, right = 0;
  const double below = CostOf(arrays, node + 1, &left) + CostOf(arrays, n.offset, &right);
  *references = left + right;
  const double split = costs.Split(n.bounds.HalfArea(), 0) + below;
  return *references <= Config().max_leaf_size ? std::min(split, costs.Leaf(n.bounds.HalfArea(), *references)) : split;
}

uint64_t Wins(const BuildContext& context) {
  return std::accumulate(context.candidate_wins.begin(), context.candidate_wins.end(), uint64_t{0});
}

TEST(DeltaLeafTest, IsTheCheapestOfItsCandidates) {
  const Config config = MakeConfig(Builder::kHybrid, Preset::kBest);
  BuildContext context;
  for (uint64_t seed = 0; seed < 30; ++seed) {
    const std::vector<Reference> references = RandomReferences(32, seed, 0.02 * static_cast<double>(seed + 1));
    const Bounds bounds = UnionOf(references);
    const double diagonal = Length(static_cast<Vec3d>(bounds.max) - static_cast<Vec3d>(bounds.min));
    uint32_t count = 0;
    const double cost = CostOf(BuildDeltaLeaf(references, bounds, config, context), 0, &count);
    EXPECT_EQ(count, references.size());
    double least = std::numeric_limits<double>::infinity();
    for (const Dendrogram& dendrogram : {Cluster(references, ClusteringCost(0.6, config, bounds, diagonal), context),
                                         Cluster(references, ClusteringCost(1, config, bounds, diagonal), context),
                                         Cluster(references, ClusteringCost(0, config, bounds, diagonal), context),
                                         SplitBySweeps(references, SahCosts(Config()), context)}) {
      least = std::min(least, CollapsedTree(references, dendrogram, SahCosts(config), 8).cost());
    }
    EXPECT_NEAR(cost, least, 1e-9 * least) << seed;
  }
  EXPECT_EQ(Wins(context), 30u);
  // They differ enough for more than one to win.
  EXPECT_LT(*std::max_element(context.candidate_wins.begin(), context.candidate_wins.end()), 30u);
}

TEST(DeltaLeafTest, FastPresetOnlySplits) {
  BuildContext context;
  const std::vector<Reference> references = RandomReferences(32, 1);
  BuildDeltaLeaf(references, UnionOf(references), MakeConfig(Builder::kHybrid, Preset::kFast), context);
  EXPECT_EQ(context.candidate_wins[static_cast<size_t>(DeltaLeafCandidate::kTopDown)], 1u);
}

TEST(DeltaLeafTest, FastPresetMakesOneLeafOfWhatFits) {
  BuildContext context;
  const std::vector<Reference> references = RandomReferences(8, 1);
  const BvhArrays arrays =
      BuildDeltaLeaf(references, UnionOf(references), MakeConfig(Builder::kHybrid, Preset::kFast), context);
  ASSERT_EQ(arrays.nodes.size(), 1u);
  EXPECT_EQ(arrays.nodes[0].count, 8u);
  EXPECT_EQ(arrays.references.size(), 8u);
}

// Clustering nests these in a chain as deep as they are many.
TEST(DeltaLeafTest, DepthIsBounded) {
  std::vector<Reference> references(200);
  for (uint32_t i = 0; i < references.size(); ++i) {
    const float size = std::ldexp(1.0f, static_cast<int>(i) - 100);
    references[i] = {{{0, 0, 0}, {size, size, size}}, i};
  }
  BuildContext context;
  Config config;
  config.max_leaf_size = 1;
  const BvhArrays arrays = BuildDeltaLeaf(references, UnionOf(references), config, context);
  ASSERT_EQ(arrays.nodes.size(), 399u);
  std::vector<uint32_t> depths(arrays.nodes.size(), 0);
  for (size_t i = 0; i < arrays.nodes.size(); ++i) {
    EXPECT_LE(depths[i], kMaxTopDownDepth);
    if (!arrays.nodes[i].IsLeaf()) depths[i + 1] = depths[arrays.nodes[i].offset] = depths[i] + 1;
  }
}

TEST(DeltaLeafTest, OneReferenceIsOneLeaf) {
  BuildContext context;
  const std::vector<Reference> one = RandomReferences(1, 1);
  const BvhArrays arrays = BuildDeltaLeaf(one, UnionOf(one), Config(), context);
  ASSERT_EQ(arrays.nodes.size(), 1u);
  EXPECT_EQ(arrays.references, std::vector<uint32_t>{0});
}

}  // namespace
}  // namespace deltaray
