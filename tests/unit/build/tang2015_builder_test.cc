#include "server/build/tang2015_builder.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "gtest/gtest.h"
#include "server/build/reference.h"
#include "tests/scenes/made.h"
#include "tests/scenes/pathological.h"
#include "tests/scenes/shapes.h"

namespace deltaray {
namespace {

Config TangConfig(uint32_t delta = 32) {
  Config config = MakeConfig(Builder::kTang2015, Preset::kBalanced);
  config.delta = delta;
  return config;
}

struct Top {
  BvhNodes nodes;
  std::vector<Reference> references;
  uint64_t triangles = 0;  // that are not degenerate
  uint64_t spatial_splits = 0, other_splits = 0, delta_leaves = 0;
};

Top BuildTopWith(const TriangleMesh& mesh, const Config& config, int threads = 1) {
  Top top;
  tbb::task_arena(threads).execute([&] {
    BuildContext context;
    absl::StatusOr<ReferenceArray> references = MakeReferences(mesh.triangles(), config.duplication_budget, context);
    ASSERT_TRUE(references.ok());
    const absl::StatusOr<SplitTree> tree = BuildTang2015Top(*std::move(references), config, context);
    ASSERT_TRUE(tree.ok()) << tree.status();
    const std::span<const Reference> placed = tree->references.span();
    top = {tree->nodes,
           {placed.begin(), placed.end()},
           context.triangles,
           context.spatial_splits,
           context.object_splits + context.median_splits,
           context.delta_leaves};
    EXPECT_EQ(context.references_placed, placed.size());
  });
  return top;
}

class Tang2015BuilderSceneTest : public testing::TestWithParam<PathologicalScene> {};

INSTANTIATE_TEST_SUITE_P(Scenes, Tang2015BuilderSceneTest, testing::ValuesIn(PathologicalScenes()),
                         [](const auto& info) { return std::string(info.param.name); });

TEST_P(Tang2015BuilderSceneTest, EndsWithinItsLimitsAtFullSize) {
  const TriangleMesh mesh = GetParam().make(GetParam().full_size);
  const Config config = TangConfig();
  const Top top = BuildTopWith(mesh, config);
  EXPECT_LE(top.references.size(), static_cast<double>(top.triangles) * (1 + config.duplication_budget));
  std::vector<bool> placed(mesh.indices.size());
  uint64_t leaves = 0, next = 0;
  for (const BvhNode& node : top.nodes) {
    if (!node.IsLeaf()) continue;
    ++leaves;
    EXPECT_LT(node.count, config.delta);
    EXPECT_EQ(node.offset, next);
    next += node.count;
    for (uint32_t i = 0; i < node.count; ++i) {
      const Reference& reference = top.references[node.offset + i];
      EXPECT_FALSE(Intersection(reference.bounds, node.bounds).IsEmpty());
      // Whole boxes, as printed.
      EXPECT_EQ(reference.bounds, mesh.triangles()[reference.primitive].GetBounds());
      placed[reference.primitive] = true;
    }
  }
  EXPECT_EQ(next, top.references.size());
  EXPECT_EQ(leaves, top.delta_leaves);
  EXPECT_EQ(static_cast<uint64_t>(std::count(placed.begin(), placed.end(), true)), top.triangles);
}

TEST(Tang2015BuilderTest, HalvesTheCellAcrossTheLongestAxis) {
  TriangleMesh mesh;
  for (int i = 0; i < 10; ++i) {
    const double x = 10 * i;
    AddTriangle(&mesh, {x, 0, 0}, {x + 1, 1, 0}, {x, 0, 1});
  }
  // Reaches over the others, so that any good plane cuts it; at its ends its part is far smaller than its box.
  AddTriangle(&mesh, {0, 0, 0}, {91, 1, 0}, {0, 0, 1});
  const Top top = BuildTopWith(mesh, TangConfig(8));
  ASSERT_FALSE(top.nodes[0].IsLeaf());
  const Bounds &left = top.nodes[1].bounds, &right = top.nodes[top.nodes[0].offset].bounds;
  EXPECT_EQ(left.max.x, right.min.x);
  EXPECT_EQ(left.min, top.nodes[0].bounds.min);
  EXPECT_EQ(right.max, top.nodes[0].bounds.max);
  EXPECT_EQ(top.spatial_splits, 1u);
  EXPECT_EQ(top.other_splits, 0u);
  EXPECT_EQ(top.references.size(), 12u);
}

TEST(Tang2015BuilderTest, SplitsCopiesByTheMedian) {
  TriangleMesh mesh;
  for (int i = 0; i < 100; ++i) AddTriangle(&mesh, {0, 0, 0}, {1, 0, 0}, {0, 1, 1});
  const Top top = BuildTopWith(mesh, TangConfig());
  EXPECT_EQ(top.spatial_splits, 0u);
  EXPECT_GT(top.other_splits, 0u);
  EXPECT_EQ(top.references.size(), 100u);
}

TEST(Tang2015BuilderTest, DoesNotDependOnThreads) {
  const TriangleMesh mesh = Soup(20'000);
  const Top one = BuildTopWith(mesh, TangConfig(), 1), two = BuildTopWith(mesh, TangConfig(), 2);
  ASSERT_EQ(one.nodes.size(), two.nodes.size());
  for (size_t i = 0; i < one.nodes.size(); ++i) {
    EXPECT_EQ(one.nodes[i].bounds, two.nodes[i].bounds);
    EXPECT_EQ(one.nodes[i].offset, two.nodes[i].offset);
    EXPECT_EQ(one.nodes[i].count, two.nodes[i].count);
  }
  ASSERT_EQ(one.references.size(), two.references.size());
  for (size_t i = 0; i < one.references.size(); ++i) {
    EXPECT_EQ(one.references[i].primitive, two.references[i].primitive);
  }
}

TEST(Tang2015BuilderTest, DeltaOfOneGoesDownToSingleReferences) {
  const Top top = BuildTopWith(Soup(500), TangConfig(1));
  for (const BvhNode& node : top.nodes) EXPECT_LE(node.count, 1u);
}

TEST(Tang2015BuilderTest, ClustersADeltaLeafDownToSingleReferences) {
  // Two pairs of neighbours, given in turn.
  TriangleMesh mesh;
  for (const double x : {0.0, 10.0, 1.5, 11.5}) AddTriangle(&mesh, {x, 0, 0}, {x + 1, 1, 0}, {x, 0, 1});
  BuildContext context;
  const absl::StatusOr<ReferenceArray> references = MakeReferences(mesh.triangles(), 0, context);
  ASSERT_TRUE(references.ok());
  const BvhArrays tree =
      BuildTang2015DeltaLeaf(references->span(), Bounds{{0, 0, 0}, {12.5, 1, 1}}, TangConfig(), context);
  ASSERT_EQ(tree.nodes.size(), 7u);
  EXPECT_EQ(tree.nodes[0].bounds, (Bounds{{0, 0, 0}, {12.5, 1, 1}}));
  std::vector<Bounds> children = {tree.nodes[1].bounds, tree.nodes[tree.nodes[0].offset].bounds};
  if (children[0].min.x > children[1].min.x) std::swap(children[0], children[1]);
  EXPECT_EQ(children[0], (Bounds{{0, 0, 0}, {2.5, 1, 1}}));
  EXPECT_EQ(children[1], (Bounds{{10, 0, 0}, {12.5, 1, 1}}));
  for (const BvhNode& node : tree.nodes) EXPECT_LE(node.count, 1u);
}

// As printed, distances count in the mesh's unit, so that scaling a mesh may change its tree.
TEST(Tang2015BuilderTest, DistancesAreInTheMeshsUnit) {
  const auto parts_the_small_ones = [](double scale) {
    // The first two are close, the last two small: distance merges the first pair first, area the last one.
    TriangleMesh mesh;
    const auto add = [&](double x, double size) {
      AddTriangle(&mesh, {scale * x, 0, 0}, {scale * (x + size), scale * size, 0}, {scale * x, 0, scale * size});
    };
    add(0, 10);
    add(10.5, 10);
    add(30, 0.5);
    add(45, 0.5);
    BuildContext context;
    const absl::StatusOr<ReferenceArray> references = MakeReferences(mesh.triangles(), 0, context);
    EXPECT_TRUE(references.ok());
    Bounds all;
    for (const Reference& reference : references->span()) all.Extend(reference.bounds);
    const BvhArrays tree = BuildTang2015DeltaLeaf(references->span(), all, TangConfig(), context);
    const Bounds small = Union(references->span()[2].bounds, references->span()[3].bounds);
    return std::none_of(tree.nodes.begin(), tree.nodes.end(), [&](const BvhNode& n) { return n.bounds == small; });
  };
  EXPECT_FALSE(parts_the_small_ones(1e-3));
  EXPECT_TRUE(parts_the_small_ones(1e3));
}

TEST(Tang2015BuilderTest, ACancelledBuildSaysSo) {
  const TriangleMesh mesh = Soup(1000);
  BuildContext context;
  absl::StatusOr<ReferenceArray> references = MakeReferences(mesh.triangles(), 1, context);
  ASSERT_TRUE(references.ok());
  context.Cancel();
  EXPECT_EQ(BuildTang2015Top(*std::move(references), TangConfig(), context).status().code(),
            absl::StatusCode::kCancelled);
}

}  // namespace
}  // namespace deltaray
