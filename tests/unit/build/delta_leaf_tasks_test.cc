#include "server/build/delta_leaf_tasks.h"

#include <atomic>
#include <thread>

#include "gtest/gtest.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

// A top of `count` δ-leaves in a row, of one reference each.
SplitTree Row(uint32_t count, BuildContext& context) {
  SplitTree top{{}, ReferenceArray(count, context)};
  top.references.set_size(count);
  for (uint32_t i = 0; i < count; ++i) {
    top.references.data()[i] = {Bounds{{0, 0, 0}, {1, 1, 1}}, i};
    if (i + 1 < count) top.nodes.push_back({Bounds{{0, 0, 0}, {1, 1, 1}}, 2 * i + 2, 0});
    top.nodes.push_back({Bounds{{0, 0, 0}, {1, 1, 1}}, i, 1});
  }
  return top;
}

BvhArrays OneLeaf(std::span<const Reference> references, const Bounds&) {
  return {{{references[0].bounds, 0, 1}}, {references[0].primitive}};
}

struct Tasks {
  std::shared_ptr<BuildContext> context = std::make_shared<BuildContext>();
  std::atomic<int> built{0};
  DeltaLeafTasks tasks;

  explicit Tasks(uint32_t count, std::function<void()> on_delta_leaf = nullptr)
      : tasks(
            Row(count, *context),
            [this](std::span<const Reference> references, const Bounds& bounds) {
              ++built;
              return OneLeaf(references, bounds);
            },
            std::move(on_delta_leaf), context) {}
};

TEST(DeltaLeafTasksTest, AllAreBuilt) {
  Tasks tasks(1000);
  EXPECT_TRUE(tasks.tasks.BuildAll().ok());
  EXPECT_EQ(tasks.built, 1000);
  EXPECT_EQ(tasks.context->delta_leaves_built, 1000u);
  for (uint32_t i = 0; i < 1000; ++i) {
    ASSERT_FALSE(tasks.tasks.built(i).nodes.empty());
    EXPECT_EQ(tasks.tasks.built(i).references[0], i);
  }
}

TEST(DeltaLeafTasksTest, TreesStandApartWhateverTheirOrderAndSize) {
  constexpr uint32_t kSizes[] = {3, 1, 5, 2};
  const auto context = std::make_shared<BuildContext>();
  SplitTree top{{}, ReferenceArray(11, *context)};
  top.references.set_size(11);
  const Bounds box{{0, 0, 0}, {1, 1, 1}};
  for (uint32_t i = 0; i < 11; ++i) top.references.data()[i] = {box, 100 + i};
  uint32_t first = 0;
  for (uint32_t i = 0; i < 4; first += kSizes[i++]) {
    if (i < 3) top.nodes.push_back({box, 2 * i + 2, 0});
    top.nodes.push_back({box, first, kSizes[i]});
  }
  // As many nodes as there can be; the count of each tells the δ-leaf.
  DeltaLeafTasks tasks(
      std::move(top),
      [](std::span<const Reference> references, const Bounds& bounds) {
        BvhArrays tree;
        for (const Reference& reference : references) tree.references.push_back(reference.primitive);
        tree.nodes.resize(2 * references.size() - 1, BvhNode{bounds, 0, references[0].primitive});
        return tree;
      },
      nullptr, context);
  for (const uint32_t i : {2u, 0u, 3u, 1u}) tasks.Build(i);
  first = 0;
  for (uint32_t i = 0; i < 4; first += kSizes[i++]) {
    const DeltaLeafTree tree = tasks.built(i);
    ASSERT_EQ(tree.nodes.size(), 2 * kSizes[i] - 1);
    for (const BvhNode& node : tree.nodes) EXPECT_EQ(node.count, 100 + first);
    ASSERT_EQ(tree.references.size(), kSizes[i]);
    for (uint32_t j = 0; j < kSizes[i]; ++j) EXPECT_EQ(tree.references[j], 100 + first + j);
  }
}

TEST(DeltaLeafTasksTest, EachIsBuiltOnceHoweverManyAsk) {
  Tasks tasks(200);
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&] {
      for (uint32_t i = 0; i < 200; ++i) tasks.tasks.Build(i);
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(tasks.built, 200);
  EXPECT_EQ(tasks.context->delta_leaves_built, 200u);
}

TEST(DeltaLeafTasksTest, CancelLeavesTheRest) {
  std::shared_ptr<BuildContext> context;
  std::atomic<int> begun{0};
  Tasks tasks(1000, [&] {
    if (++begun == 10) context->Cancel();
  });
  context = tasks.context;
  EXPECT_EQ(tasks.tasks.BuildAll().code(), absl::StatusCode::kCancelled);
  EXPECT_LT(tasks.context->delta_leaves_built, 1000u);
}

}  // namespace
}  // namespace deltaray
