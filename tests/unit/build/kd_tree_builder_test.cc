#include "server/build/kd_tree_builder.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/build/reference.h"
#include "tests/scenes/made.h"
#include "tests/scenes/pathological.h"

namespace deltaray {
namespace {

const Config& KdConfig() {
  static const Config config = MakeConfig(Builder::kKdTree, Preset::kBalanced);
  return config;
}

struct Result {
  KdArrays arrays;
  uint64_t triangles = 0;  // that are not degenerate
};

Result BuildWith(const TriangleMesh& mesh, const Config& config, int threads = 1) {
  Result result;
  tbb::task_arena(threads).execute([&] {
    BuildContext context;
    const absl::StatusOr<ReferenceArray> references = MakeReferences(mesh.triangles(), 0, context);
    ASSERT_TRUE(references.ok());
    absl::StatusOr<KdArrays> arrays = BuildKdTree(references->span(), mesh.triangles(), config, context);
    ASSERT_TRUE(arrays.ok()) << arrays.status();
    result = {*std::move(arrays), context.triangles};
    EXPECT_EQ(context.references_placed, result.arrays.references.size());
  });
  return result;
}

using VisitLeaf = std::function<void(const KdNode&, const Bounds& cell, int depth)>;

// Visits the leaves below a node in the order of the array. Returns the index after the subtree.
uint32_t ForEachLeaf(const KdArrays& tree, uint32_t index, const Bounds& cell, int depth, const VisitLeaf& visit) {
  const KdNode& node = tree.nodes[index];
  if (node.IsLeaf()) {
    visit(node, cell, depth);
    return index + 1;
  }
  Bounds left = cell, right = cell;
  left.max[static_cast<int>(node.axis)] = right.min[static_cast<int>(node.axis)] = node.position;
  EXPECT_FALSE(left.IsEmpty() || right.IsEmpty());
  EXPECT_EQ(ForEachLeaf(tree, index + 1, left, depth + 1, visit), node.offset);
  return ForEachLeaf(tree, node.offset, right, depth + 1, visit);
}

void ForEachLeaf(const KdArrays& tree, const VisitLeaf& visit) {
  if (tree.nodes.empty()) return;
  EXPECT_EQ(ForEachLeaf(tree, 0, tree.bounds, 0, visit), tree.nodes.size());
}

enum class Place { kOutside, kOnFace, kInside };

Place Locate(const Bounds& box, Vec3d p) {
  Place place = Place::kInside;
  for (int axis = 0; axis < 3; ++axis) {
    if (p[axis] < box.min[axis] || p[axis] > box.max[axis]) return Place::kOutside;
    if (p[axis] == box.min[axis] || p[axis] == box.max[axis]) place = Place::kOnFace;
  }
  return place;
}

// Points that lie exactly on a triangle: its corners, and the middles of edges that double can hold.
std::vector<Vec3d> ExactPoints(const Triangle& triangle) {
  std::vector<Vec3d> points = {static_cast<Vec3d>(triangle.v0), static_cast<Vec3d>(triangle.v1),
                               static_cast<Vec3d>(triangle.v2)};
  for (int i = 0; i < 3; ++i) {
    const Vec3d a = points[i], b = points[(i + 1) % 3], sum = a + b;
    if (sum - a == b && sum - b == a) points.push_back(0.5 * sum);
  }
  return points;
}

class KdTreeBuilderSceneTest : public testing::TestWithParam<PathologicalScene> {};

INSTANTIATE_TEST_SUITE_P(Scenes, KdTreeBuilderSceneTest, testing::ValuesIn(PathologicalScenes()),
                         [](const auto& info) { return std::string(info.param.name); });

TEST_P(KdTreeBuilderSceneTest, EveryPointOfATriangleIsInALeafThatHasIt) {
  const TriangleMesh mesh = GetParam().make(GetParam().small_size);
  const Result result = BuildWith(mesh, KdConfig());
  std::vector<std::pair<uint32_t, Vec3d>> points;
  BuildContext context;
  const absl::StatusOr<ReferenceArray> references = MakeReferences(mesh.triangles(), 0, context);
  ASSERT_TRUE(references.ok());
  for (const Reference& reference : references->span()) {
    for (Vec3d p : ExactPoints(mesh.triangles()[reference.primitive])) points.emplace_back(reference.primitive, p);
  }

  std::vector<int> found(points.size());
  ForEachLeaf(result.arrays, [&](const KdNode& leaf, const Bounds& cell, int) {
    const auto begin = result.arrays.references.begin() + leaf.offset;
    for (size_t i = 0; i < points.size(); ++i) {
      const auto& [primitive, p] = points[i];
      const Place place = Locate(cell, p);
      if (place == Place::kOutside) continue;
      const bool has = std::find(begin, begin + leaf.count, primitive) != begin + leaf.count;
      found[i] += has;
      EXPECT_TRUE(has || place == Place::kOnFace) << "triangle " << primitive;
    }
  });
  EXPECT_THAT(found, testing::Each(testing::Gt(0)));
}

TEST_P(KdTreeBuilderSceneTest, EndsWithinItsLimitsAtFullSize) {
  const TriangleMesh mesh = GetParam().make(GetParam().full_size);
  const Result result = BuildWith(mesh, KdConfig());
  const double count = static_cast<double>(result.triangles);
  EXPECT_LE(result.arrays.references.size(), count * (1 + KdConfig().duplication_budget));
  int depth = 0;
  size_t next = 0;
  ForEachLeaf(result.arrays, [&](const KdNode& leaf, const Bounds&, int leaf_depth) {
    depth = std::max(depth, leaf_depth);
    EXPECT_EQ(leaf.offset, next);
    next += leaf.count;
  });
  EXPECT_EQ(next, result.arrays.references.size());
  if (count > 0) {
    EXPECT_LE(depth, 8 + 1.3 * std::log2(count));
  }
}

TEST(KdTreeBuilderTest, ReferencesOfALeafAreDistinct) {
  const Result result = BuildWith(Soup(3000), KdConfig());
  ForEachLeaf(result.arrays, [&](const KdNode& leaf, const Bounds&, int) {
    const auto begin = result.arrays.references.begin() + leaf.offset;
    std::vector<uint32_t> ids(begin, begin + leaf.count);
    std::sort(ids.begin(), ids.end());
    EXPECT_EQ(std::adjacent_find(ids.begin(), ids.end()), ids.end());
  });
}

TEST(KdTreeBuilderTest, DoesNotDependOnThreads) {
  const TriangleMesh mesh = City(30, 300);
  const KdArrays one = BuildWith(mesh, KdConfig(), 1).arrays, two = BuildWith(mesh, KdConfig(), 2).arrays;
  EXPECT_EQ(one.references, two.references);
  ASSERT_EQ(one.nodes.size(), two.nodes.size());
  for (size_t i = 0; i < one.nodes.size(); ++i) {
    EXPECT_EQ(one.nodes[i].position, two.nodes[i].position);
    EXPECT_EQ(one.nodes[i].axis, two.nodes[i].axis);
    EXPECT_EQ(one.nodes[i].offset, two.nodes[i].offset);
    EXPECT_EQ(one.nodes[i].count, two.nodes[i].count);
  }
}

TEST(KdTreeBuilderTest, AddsNothingWithoutABudget) {
  Config config = KdConfig();
  config.duplication_budget = 0;
  const Result result = BuildWith(Soup(2000), config);
  EXPECT_EQ(result.arrays.references.size(), result.triangles);
}

TEST(KdTreeBuilderTest, SplitsFlatMeshes) {
  TriangleMesh mesh = Terrain(64, 64);
  for (Vec3f& p : mesh.positions) p.z = 1;
  const Result result = BuildWith(mesh, KdConfig());
  uint32_t largest = 0;
  ForEachLeaf(result.arrays, [&](const KdNode& leaf, const Bounds&, int) { largest = std::max(largest, leaf.count); });
  EXPECT_LE(largest, 8u);
}

TEST(KdTreeBuilderTest, CutsOffEmptySpace) {
  // Two small patches in opposite corners: most of the box is empty.
  TriangleMesh mesh = Terrain(8, 8);
  const TriangleMesh patch = mesh;
  const auto first = static_cast<uint32_t>(patch.positions.size());
  for (Vec3f p : patch.positions) mesh.positions.push_back(p + Vec3f{1000, 1000, 1000});
  for (auto [a, b, c] : patch.indices) mesh.indices.push_back({first + a, first + b, first + c});
  const Result result = BuildWith(mesh, KdConfig());
  double occupied = 0;
  ForEachLeaf(result.arrays, [&](const KdNode& leaf, const Bounds& cell, int) {
    if (leaf.count != 0) occupied += cell.HalfArea();
  });
  EXPECT_LT(occupied, 0.01 * result.arrays.bounds.HalfArea());
}

TEST(KdTreeBuilderTest, ACancelledBuildSaysSo) {
  const TriangleMesh mesh = Soup(1000);
  BuildContext context;
  const absl::StatusOr<ReferenceArray> references = MakeReferences(mesh.triangles(), 0, context);
  ASSERT_TRUE(references.ok());
  context.Cancel();
  EXPECT_EQ(BuildKdTree(references->span(), mesh.triangles(), KdConfig(), context).status().code(),
            absl::StatusCode::kCancelled);
}

}  // namespace
}  // namespace deltaray
