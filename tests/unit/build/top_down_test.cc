#include "server/build/top_down.h"

#include <tbb/task_arena.h>

#include <cstring>
#include <string>

#include "gtest/gtest.h"
#include "tests/scenes/made.h"
#include "tests/scenes/pathological.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

struct TopResult {
  BvhArrays arrays;
  std::vector<Reference> references;
  uint64_t triangles = 0, spatial_splits = 0, object_splits = 0, median_splits = 0, delta_leaves = 0, placed = 0;
};

TopResult BuildWith(const TriangleMesh& mesh, const Config& config, bool top, int threads = 2) {
  TopResult result;
  tbb::task_arena(threads).execute([&] {
    BuildContext context;
    absl::StatusOr<ReferenceArray> references = MakeReferences(mesh.triangles(), config.duplication_budget, context);
    ASSERT_TRUE(references.ok());
    const absl::StatusOr<SplitTree> tree =
        (top ? BuildTop : BuildTopDown)(*std::move(references), mesh.triangles(), config, context);
    ASSERT_TRUE(tree.ok()) << tree.status();
    const std::span<const Reference> placed = tree->references.span();
    result = {ToBvhArrays(*tree),    {placed.begin(), placed.end()}, context.triangles,    context.spatial_splits,
              context.object_splits, context.median_splits,          context.delta_leaves, context.references_placed};
  });
  return result;
}

class TopDownSceneTest : public testing::TestWithParam<PathologicalScene> {};

INSTANTIATE_TEST_SUITE_P(Scenes, TopDownSceneTest, testing::ValuesIn(PathologicalScenes()),
                         [](const auto& info) { return std::string(info.param.name); });

TEST_P(TopDownSceneTest, TopKeepsToItsLimits) {
  const TriangleMesh mesh = GetParam().make(std::min(GetParam().full_size, 1000u));
  for (const uint32_t delta : {1, 32}) {
    Config config;
    config.delta = delta;
    const TopResult top = BuildWith(mesh, config, true);
    CheckBvh(top.arrays, mesh.triangles());
    EXPECT_LE(top.references.size(), 2 * top.triangles);
    EXPECT_EQ(top.placed, top.references.size());
    std::vector<uint32_t> depths(top.arrays.nodes.size(), 0);
    uint64_t leaves = 0;
    for (size_t i = 0; i < top.arrays.nodes.size(); ++i) {
      const BvhNode& node = top.arrays.nodes[i];
      EXPECT_LE(node.count, delta);
      EXPECT_LE(depths[i], kMaxTopDownDepth);
      if (!node.IsLeaf()) {
        depths[i + 1] = depths[node.offset] = depths[i] + 1;
        continue;
      }
      ++leaves;
      const auto references = std::span<const Reference>(top.references).subspan(node.offset, node.count);
      EXPECT_EQ(UnionOf(references), node.bounds) << "not the box of its references";
    }
    EXPECT_EQ(top.delta_leaves, leaves);
    EXPECT_EQ(top.spatial_splits + top.object_splits + top.median_splits, leaves == 0 ? 0 : leaves - 1);
  }
}

TEST_P(TopDownSceneTest, TreesOfLeavesKeepToTheirLimits) {
  const TriangleMesh mesh = GetParam().make(std::min(GetParam().full_size, 1000u));
  for (const Builder builder : {Builder::kBvh, Builder::kSbvh}) {
    const Config config = MakeConfig(builder, Preset::kBalanced);
    const TopResult tree = BuildWith(mesh, config, false);
    CheckBvh(tree.arrays, mesh.triangles());
    EXPECT_LE(tree.references.size(), (1 + config.duplication_budget) * static_cast<double>(tree.triangles));
    for (const BvhNode& node : tree.arrays.nodes) EXPECT_LE(node.count, config.max_leaf_size);
    EXPECT_EQ(tree.delta_leaves, 0u);
  }
}

// More than δ triangles meet in a spot, whatever plane there is.
TEST(TopDownTest, FanAndCopiesDoNotRunAway) {
  for (const PathologicalScene& scene : PathologicalScenes()) {
    if (scene.name != "fan" && scene.name != "copies") continue;
    const TriangleMesh mesh = scene.make(scene.full_size);
    const TopResult top = BuildWith(mesh, Config(), true);
    EXPECT_GE(top.references.size(), 10'000u);
    EXPECT_LE(static_cast<double>(top.references.size()), 1.01 * static_cast<double>(top.triangles));
  }
}

TEST(TopDownTest, SplitsInSpaceWhereBoxesOverlapAndOnlyThere) {
  const TopResult city = BuildWith(City(20, 500), Config(), true);
  EXPECT_GT(city.spatial_splits, 0u);
  TriangleMesh sphere;
  AddSphere(&sphere, {0, 0, 0}, 1, 40);
  const TopResult smooth = BuildWith(sphere, Config(), true);
  EXPECT_LE(100 * smooth.spatial_splits, smooth.object_splits);
  Config never;
  never.spatial_split_gate = 1;
  EXPECT_EQ(BuildWith(City(20, 500), never, true).spatial_splits, 0u);
}

TEST(TopDownTest, ABudgetOfNothingAddsNoReference) {
  Config config;
  config.duplication_budget = 0;
  const TopResult top = BuildWith(Soup(5000), config, true);
  EXPECT_EQ(top.references.size(), 5000u);
}

TEST(TopDownTest, SameBytesForAnyNumberOfThreads) {
  const TriangleMesh mesh = Soup(10'000);
  const TopResult one = BuildWith(mesh, Config(), true, 1);
  EXPECT_GT(one.spatial_splits, 0u);
  for (const int threads : {2, 4}) {
    const TopResult more = BuildWith(mesh, Config(), true, threads);
    ASSERT_EQ(more.arrays.nodes.size(), one.arrays.nodes.size());
    EXPECT_EQ(std::memcmp(more.arrays.nodes.data(), one.arrays.nodes.data(), one.arrays.nodes.size() * sizeof(BvhNode)),
              0);
    EXPECT_EQ(more.arrays.references, one.arrays.references);
    ASSERT_EQ(more.references.size(), one.references.size());
    EXPECT_EQ(std::memcmp(more.references.data(), one.references.data(), one.references.size() * sizeof(Reference)), 0);
  }
}

TEST(TopDownTest, CanBeCancelled) {
  const TriangleMesh mesh = Soup(1000);
  BuildContext context;
  absl::StatusOr<ReferenceArray> references = MakeReferences(mesh.triangles(), 1, context);
  ASSERT_TRUE(references.ok());
  context.Cancel();
  EXPECT_EQ(BuildTop(*std::move(references), mesh.triangles(), Config(), context).status().code(),
            absl::StatusCode::kCancelled);
}

}  // namespace
}  // namespace deltaray
