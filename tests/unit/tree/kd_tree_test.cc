#include "server/tree/kd_tree.h"

#include <vector>

#include "gtest/gtest.h"
#include "tests/unit/tree/small_trees.h"

namespace deltaray {
namespace {

TEST(KdTreeTest, AnswersAsBruteForce) {
  for (const uint64_t seed : {3, 4}) {
    const SmallScene scene = GridScene(120, seed);
    for (const int depth : {0, 3, 12}) {
      SCOPED_TRACE(testing::Message() << "depth " << depth);
      const KdTree tree(scene.view(), MakeKd(scene.view(), depth));
      ExpectSameAsBruteForce(tree, scene.view(), GridRays(scene, 500, seed + 10));
    }
  }
}

// A triangle in the plane z = 4 is in one of the two cells that share that plane; a ray within the plane and one
// through it must look into both.
TEST(KdTreeTest, TrianglesInAPlaneAreFoundFromBothSides) {
  for (const bool is_above : {false, true}) {
    SmallScene scene;
    scene.Add({{0, 0, 4}, {8, 0, 4}, {0, 8, 4}});
    scene.Add({{4, 0, 0}, {4, 8, 0}, {4, 0, 8}});
    KdArrays arrays{.bounds = {{0, 0, 0}, {8, 8, 8}}, .nodes = {}, .references = {}};
    arrays.nodes = {{4, 2, 2, 0}, {0, KdNode::kLeaf, 0, is_above ? 1u : 2u}, {0, KdNode::kLeaf, is_above ? 1u : 2u, 0}};
    arrays.nodes[2].count = 3 - arrays.nodes[1].count;
    arrays.references = {1, 0, 1};
    if (is_above) arrays.references = {1, 1, 0};
    const KdTree tree(scene.view(), arrays);
    std::vector<Ray> rays;
    for (const float side : {1.0f, -1.0f}) {
      rays.push_back({.origin = {1, 1, 4 - 8 * side}, .direction = {0, 0, side}});
      rays.push_back({.origin = {1, 1, 4}, .direction = {0, 0, side}});
      rays.push_back({.origin = {4 - 3 * side, 1, 4}, .direction = {side, 0, -0.0f}});
      rays.push_back({.origin = {4 - 9 * side, 1, 4}, .t_min = -20, .direction = {side, 0, 0}});
    }
    ExpectSameAsBruteForce(tree, scene.view(), rays);
    std::vector<uint8_t> any(rays.size());
    tree.AnyHits(rays, {}, any);
    EXPECT_EQ(any, std::vector<uint8_t>(rays.size(), 1));
  }
}

// The ray goes through the line where two planes cross, so that it is in the third cell in one point only, at a t that
// rounds differently for each plane; and a corner of a triangle in that cell alone is there.
TEST(KdTreeTest, ACellThatIsMetInOnePointIsSearched) {
  for (int n = 3; n < 50; n += 2) {
    for (int i = 1; i < 20; ++i) {
      const float x = static_cast<float>(i), y = static_cast<float>(20 - i);
      SmallScene scene;
      scene.Add({{x, y, 1}, {x + 1, y - 1, 1}, {x + 1, y - 1, 2}});
      KdArrays arrays{.bounds = {{0, 0, 0}, {40, 40, 2}}, .nodes = {}, .references = {0}};
      arrays.nodes = {
          {x, 0, 2, 0}, {0, KdNode::kLeaf, 0, 0}, {y, 1, 4, 0}, {0, KdNode::kLeaf, 0, 1}, {0, KdNode::kLeaf, 1, 0}};
      const KdTree tree(scene.view(), arrays);
      const auto f = static_cast<float>(n);
      const Ray ray{.origin = {0, 0, 0}, .direction = {f * x, f * y, f}};
      Hit hit;
      tree.ClosestHits({&ray, 1}, {}, {&hit, 1});
      EXPECT_TRUE(hit.IsHit()) << x << " " << y << " " << n;
    }
  }
}

// A long triangle is met in the near cell, but hit in the far one, behind another triangle.
TEST(KdTreeTest, AHitBeyondTheCellDoesNotEndTheSearch) {
  SmallScene scene;
  scene.Add({{0, -1, -1}, {10, -1, 1}, {0, 3, -1}});
  scene.Add({{4.5f, -1, -1}, {4.5f, 3, -1}, {4.5f, -1, 3}});
  KdArrays arrays{.bounds = {{0, -1, -1}, {10, 3, 3}}, .nodes = {}, .references = {}};
  arrays.nodes = {{4, 0, 2, 0}, {0, KdNode::kLeaf, 0, 1}, {0, KdNode::kLeaf, 1, 2}};
  arrays.references = {0, 0, 1};
  const KdTree tree(scene.view(), arrays);
  const Ray ray{.origin = {-1, -0.5f, 0}, .direction = {1, 0, 0}};
  Hit hit;
  tree.ClosestHits({&ray, 1}, {}, {&hit, 1});
  EXPECT_EQ(hit.primitive, 1u);
  EXPECT_EQ(hit.t, 5.5f);
}

TEST(KdTreeTest, EmptyTreeMisses) {
  const SmallScene scene;
  const KdTree tree(scene.view(), {});
  ExpectSameAsBruteForce(tree, scene.view(), std::vector<Ray>{{.origin = {0, 0, 0}, .direction = {0, 0, 1}}});
  EXPECT_EQ(tree.Shape().nodes, 0u);
}

TEST(KdTreeTest, ShapeCountsWhatIsThere) {
  const SmallScene scene = GridScene(3, 1);
  KdArrays arrays{.bounds = {{0, 0, 0}, {4, 4, 4}}, .nodes = {}, .references = {}};
  arrays.nodes = {{1, 0, 2, 0}, {0, KdNode::kLeaf, 0, 2}, {0, KdNode::kLeaf, 2, 0}};
  arrays.references = {0, 1};
  const TreeShape shape = KdTree(scene.view(), arrays).Shape();
  EXPECT_EQ(shape.nodes, 3u);
  EXPECT_EQ(shape.leaves, 2u);
  EXPECT_EQ(shape.references, 2u);
  EXPECT_EQ(shape.max_depth, 1u);
  EXPECT_DOUBLE_EQ(shape.sah_cost, 1 + 2 * 24.0 / 48);
  EXPECT_EQ(shape.node_bytes, 48u);
  EXPECT_EQ(shape.reference_bytes, 8u);
}

}  // namespace
}  // namespace deltaray
