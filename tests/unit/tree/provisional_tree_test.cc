#include "server/tree/provisional_tree.h"

#include <atomic>
#include <memory>
#include <thread>
#include <utility>
#include <vector>

#include "gtest/gtest.h"
#include "tests/unit/tree/small_trees.h"

namespace deltaray {
namespace {

// The lists of the δ-leaves, by number.
std::vector<std::vector<uint32_t>> DeltaLeafLists(const BvhArrays& top) {
  std::vector<std::vector<uint32_t>> lists;
  for (const BvhNode& node : top.nodes) {
    if (!node.IsLeaf()) continue;
    const auto references = top.LeafReferences(node);
    lists.emplace_back(references.begin(), references.end());
  }
  return lists;
}

TEST(ProvisionalTreeTest, AnswersAsBruteForceWhileDeltaLeavesAreBuilt) {
  const SmallScene scene = GridScene(120, 5);
  const std::vector<Ray> rays = GridRays(scene, 200, 6);
  ProvisionalTree tree(scene.view(), MakeBvh(scene.view(), 16, 3));
  const auto lists = DeltaLeafLists(tree.top());
  ASSERT_EQ(tree.delta_leaf_count(), lists.size());
  for (uint32_t i = 0; i < lists.size(); ++i) {
    if (i % 6 == 0) ExpectSameAsBruteForce(tree, scene.view(), rays);
    EXPECT_EQ(tree.delta_leaves_built(), i);
    EXPECT_EQ(tree.delta_leaf(i), nullptr);
    tree.PublishDeltaLeaf(i, MakeSubtree(scene.view(), lists[i]));
    EXPECT_NE(tree.delta_leaf(i), nullptr);
  }
  ExpectSameAsBruteForce(tree, scene.view(), rays);
}

TEST(ProvisionalTreeTest, ReachesOnlyDeltaLeavesThatRaysReach) {
  SmallScene scene;
  for (int i = 0; i < 4; ++i) {
    const auto x = static_cast<float>(10 * i);
    scene.Add({{x, 0, 0}, {x + 1, 0, 0}, {x, 1, 0}});
  }
  std::vector<uint32_t> reached;
  ProvisionalTree* tree_pointer = nullptr;
  ProvisionalTree tree(scene.view(), MakeBvh(scene.view(), 1, 0), [&](uint32_t i) {
    reached.push_back(i);
    // δ-leaf 2 is built when it is reached, the others are not.
    if (i == 2) tree_pointer->PublishDeltaLeaf(i, MakeSubtree(scene.view(), std::vector<uint32_t>{i}));
  });
  tree_pointer = &tree;
  const Ray at_2{.origin = {20.1f, 0.1f, -1}, .direction = {0, 0, 1}};
  const Ray at_3{.origin = {30.1f, 0.1f, -1}, .direction = {0, 0, 1}};
  const std::vector<Ray> rays = {at_2, at_2, at_3, at_3};
  std::vector<Hit> hits(rays.size());
  tree.ClosestHits(rays, {}, hits);
  EXPECT_EQ(hits[0].primitive, 2u);
  EXPECT_EQ(hits[1].primitive, 2u);
  EXPECT_EQ(hits[3].primitive, 3u);
  EXPECT_EQ(reached, (std::vector<uint32_t>{2, 3, 3}));
  EXPECT_EQ(tree.delta_leaves_built(), 1u);
}

TEST(ProvisionalTreeTest, ShapeIsOfThePartsBuilt) {
  SmallScene scene;
  scene.Add({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}});
  scene.Add({{3, 0, 0}, {4, 0, 0}, {3, 1, 0}});
  scene.Add({{3, 0, 0}, {4, 0, 0}, {3, 1, 0}});
  scene.Add({{3, 0, 0}, {4, 0, 0}, {3, 1, 0}});
  BvhArrays top;
  top.nodes = {{{{0, 0, 0}, {4, 1, 0}}, 2, 0}, {{{0, 0, 0}, {1, 1, 0}}, 0, 1}, {{{3, 0, 0}, {4, 1, 0}}, 1, 3}};
  top.references = {0, 1, 2, 3};
  ProvisionalTree tree(scene.view(), top);
  EXPECT_EQ(tree.Shape().leaves, 2u);
  EXPECT_EQ(tree.Shape().max_depth, 1u);
  EXPECT_DOUBLE_EQ(tree.Shape().sah_cost, 1 + 1 * 0.25 + 3 * 0.25);
  tree.PublishDeltaLeaf(1, MakeSubtree(scene.view(), std::vector<uint32_t>{1, 2, 3}));
  const TreeShape shape = tree.Shape();
  EXPECT_EQ(shape.nodes, 5u);
  EXPECT_EQ(shape.leaves, 3u);
  EXPECT_EQ(shape.references, 4u);
  EXPECT_EQ(shape.max_depth, 2u);
  EXPECT_DOUBLE_EQ(shape.sah_cost, 1 + 1 * 0.25 + 1 * 0.25 + (1 + 2) * 0.25);
  EXPECT_EQ(shape.node_bytes, 6u * 32);
  EXPECT_EQ(shape.reference_bytes, 7u * 4);
}

TEST(ProvisionalTreeTest, EmptyTreeMisses) {
  const SmallScene scene;
  const ProvisionalTree tree(scene.view(), {});
  EXPECT_EQ(tree.delta_leaf_count(), 0u);
  ExpectSameAsBruteForce(tree, scene.view(), std::vector<Ray>{{.origin = {0, 0, 0}, .direction = {0, 0, 1}}});
}

// Meant for the thread sanitizer: two threads trace while two publish, one of them from within the traversal.
TEST(ProvisionalTreeTest, AnswersStayTheSameWhileOthersPublish) {
  const SmallScene scene = GridScene(300, 7);
  const std::vector<Ray> rays = GridRays(scene, 300, 8);
  std::vector<Hit> expected(rays.size());
  BruteForce(scene.view()).ClosestHits(rays, {}, expected);

  const BvhArrays top = MakeBvh(scene.view(), 8, 4);
  const auto lists = DeltaLeafLists(top);
  std::vector<std::atomic<bool>> is_taken(lists.size());
  ProvisionalTree* tree_pointer = nullptr;
  const auto publish = [&](uint32_t i) {
    if (!is_taken[i].exchange(true)) tree_pointer->PublishDeltaLeaf(i, MakeSubtree(scene.view(), lists[i]));
  };
  ProvisionalTree tree(scene.view(), top, [&](uint32_t i) {
    if (i % 2 == 0) publish(i);
  });
  tree_pointer = &tree;

  std::vector<std::vector<Hit>> answers(2, std::vector<Hit>(rays.size()));
  std::vector<std::thread> threads;
  for (auto& hits : answers) {
    threads.emplace_back([&] {
      for (size_t i = 0; i < rays.size(); ++i) tree.ClosestHits({&rays[i], 1}, {}, {&hits[i], 1});
    });
  }
  threads.emplace_back([&] {
    for (uint32_t i = 1; i < lists.size(); i += 2) {
      publish(i);
      std::this_thread::yield();
    }
  });
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(answers[0], expected);
  EXPECT_EQ(answers[1], expected);
  for (uint32_t i = 1; i < lists.size(); i += 2) EXPECT_NE(tree.delta_leaf(i), nullptr);
}

}  // namespace
}  // namespace deltaray
