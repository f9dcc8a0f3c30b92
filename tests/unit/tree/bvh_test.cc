#include "server/tree/bvh.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "gtest/gtest.h"
#include "tests/unit/tree/small_trees.h"

namespace deltaray {
namespace {

TEST(BvhTest, AnswersAsBruteForce) {
  for (const uint64_t seed : {1, 2}) {
    const SmallScene scene = GridScene(120, seed);
    for (const auto& [leaf_size, spatial] : {std::pair(1, 0), std::pair(4, 0), std::pair(1, 5), std::pair(8, 3)}) {
      SCOPED_TRACE(testing::Message() << "leaves of " << leaf_size << ", spatial splits to depth " << spatial);
      const Bvh tree(scene.view(), MakeBvh(scene.view(), leaf_size, spatial));
      ExpectSameAsBruteForce(tree, scene.view(), GridRays(scene, 400, seed + 10));
    }
  }
}

TEST(BvhTest, SpatialSplitsRepeatTrianglesButNotHits) {
  SmallScene scene;
  scene.Add({{0, 0, 0}, {8, 0, 0}, {8, 0, 8}});
  scene.Add({{0, 1, 0}, {8, 1, 0}, {8, 1, 8}});
  const BvhArrays arrays = MakeBvh(scene.view(), 1, 2);
  ASSERT_GT(arrays.references.size(), 3u);
  const Bvh tree(scene.view(), arrays);
  // Through the corner where the parts meet.
  const Ray ray{.origin = {4, -1, 2}, .direction = {0, 1, 0}};
  uint32_t count = 0;
  tree.CountHits({&ray, 1}, {}, {&count, 1});
  EXPECT_EQ(count, 2u);
  std::vector<Hit> hits;
  tree.AllHits({&ray, 1}, {}, &hits, {&count, 1});
  EXPECT_EQ(hits.size(), 2u);
}

TEST(BvhTest, EmptyTreeMisses) {
  const SmallScene scene;
  const Bvh tree(scene.view(), {});
  ExpectSameAsBruteForce(tree, scene.view(), std::vector<Ray>{{.origin = {0, 0, 0}, .direction = {0, 0, 1}}});
  EXPECT_EQ(tree.Shape().nodes, 0u);
  EXPECT_EQ(tree.Shape().sah_cost, 0);
}

TEST(BvhTest, NoRays) {
  const SmallScene scene = GridScene(10, 1);
  const Bvh tree(scene.view(), MakeBvh(scene.view(), 2, 0));
  ExpectSameAsBruteForce(tree, scene.view(), {});
}

// A tree that is a list: every inner node has one leaf and all the rest.
TEST(BvhTest, DeepTreesDoNotOverflowTheStack) {
  constexpr uint32_t kDepth = 20'000;
  SmallScene scene;
  BvhArrays arrays;
  for (uint32_t i = 0; i < kDepth; ++i) {
    const auto z = static_cast<float>(kDepth - i);
    scene.Add({{-1, -1, z}, {1, -1, z}, {0, 1, z}});
    arrays.references.push_back(i);
  }
  const Bounds rest{{-1, -1, 1}, {1, 1, static_cast<float>(kDepth)}};
  for (uint32_t i = 0; i < kDepth; ++i) {
    // The far leaf comes first in memory, so that each inner node leaves one entry on the stack.
    if (i + 1 < kDepth) arrays.nodes.push_back({rest, 2 * i + 2, 0});
    arrays.nodes.push_back({scene.view()[i].GetBounds(), i, 1});
  }
  const Bvh tree(scene.view(), arrays);
  EXPECT_EQ(tree.Shape().max_depth, kDepth - 1);
  const Ray ray{.origin = {0, 0, 0}, .direction = {0, 0, 1}};
  Hit hit;
  tree.ClosestHits({&ray, 1}, {}, {&hit, 1});
  EXPECT_EQ(hit.primitive, kDepth - 1);
  uint32_t count = 0;
  tree.CountHits({&ray, 1}, {}, {&count, 1});
  EXPECT_EQ(count, kDepth);
}

TEST(BvhTest, ShapeCountsWhatIsThere) {
  SmallScene scene;
  scene.Add({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}});
  scene.Add({{3, 0, 0}, {4, 0, 0}, {3, 1, 0}});
  scene.Add({{3, 0, 0}, {4, 0, 0}, {3, 1, 0}});
  // Flat boxes of half areas 4, 1 and 1.
  BvhArrays arrays;
  arrays.nodes = {{{{0, 0, 0}, {4, 1, 0}}, 2, 0}, {{{0, 0, 0}, {1, 1, 0}}, 0, 1}, {{{3, 0, 0}, {4, 1, 0}}, 1, 2}};
  arrays.references = {0, 1, 2};
  const TreeShape shape = Bvh(scene.view(), arrays).Shape();
  EXPECT_EQ(shape.nodes, 3u);
  EXPECT_EQ(shape.leaves, 2u);
  EXPECT_EQ(shape.references, 3u);
  EXPECT_EQ(shape.max_depth, 1u);
  EXPECT_DOUBLE_EQ(shape.sah_cost, 1 + 1 * 0.25 + 2 * 0.25);
  EXPECT_EQ(shape.node_bytes, 96u);
  EXPECT_EQ(shape.reference_bytes, 12u);
}

}  // namespace
}  // namespace deltaray
