#include "server/build/layout.h"

#include <memory>
#include <utility>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace deltaray {
namespace {

using testing::ElementsAre;

Bounds Box(float size) { return {{0, 0, 0}, {size, size, size}}; }

// A top of two δ-leaves: the first becomes a leaf, the second two leaves.
struct Parts {
  std::shared_ptr<BuildContext> context = std::make_shared<BuildContext>();
  DeltaLeafTasks delta_leaves{Top(), BuildOne, nullptr, context};

  SplitTree Top() const {
    SplitTree top{{{Box(4), 2, 0}, {Box(2), 0, 1}, {Box(3), 1, 3}}, ReferenceArray(4, *context)};
    for (const uint32_t primitive : {7, 5, 6, 4}) top.references.Add({Box(1), primitive});
    return top;
  }
  static BvhArrays BuildOne(std::span<const Reference> references, const Bounds&) {
    if (references.size() == 1) return {{{Box(2), 0, 1}}, {7}};
    return {{{Box(3), 2, 0}, {Box(1), 0, 2}, {Box(1.5), 2, 1}}, {6, 4, 5}};
  }
};

std::vector<uint32_t> Offsets(const BvhArrays& arrays) {
  std::vector<uint32_t> offsets;
  for (const BvhNode& node : arrays.nodes) offsets.push_back(node.offset);
  return offsets;
}

std::vector<uint32_t> Counts(const BvhArrays& arrays) {
  std::vector<uint32_t> counts;
  for (const BvhNode& node : arrays.nodes) counts.push_back(node.count);
  return counts;
}

TEST(LayoutTest, DeltaLeavesStandWhereTheTopHadThem) {
  Parts parts;
  // The order in which they come makes no difference.
  parts.delta_leaves.Build(1);
  parts.delta_leaves.Build(0);
  const absl::StatusOr<BinaryLayout> layout = LayOut(parts.delta_leaves, *parts.context);
  ASSERT_TRUE(layout.ok());
  EXPECT_TRUE(layout->unbuilt.empty());
  EXPECT_THAT(layout->arrays.references, ElementsAre(7, 6, 4, 5));
  EXPECT_THAT(Counts(layout->arrays), ElementsAre(0, 1, 0, 2, 1));
  EXPECT_THAT(Offsets(layout->arrays), ElementsAre(2, 0, 4, 1, 3));
  EXPECT_EQ(layout->arrays.nodes[0].bounds, Box(4));
  EXPECT_EQ(layout->arrays.nodes[4].bounds, Box(1.5));
}

TEST(LayoutTest, DeltaLeavesThatAreNotBuiltAreGroups) {
  Parts parts;
  parts.delta_leaves.Build(0);
  const absl::StatusOr<BinaryLayout> layout = LayOut(parts.delta_leaves, *parts.context);
  ASSERT_TRUE(layout.ok());
  ASSERT_EQ(layout->unbuilt.size(), 1u);
  EXPECT_EQ(layout->unbuilt[0].delta_leaf, 1u);
  EXPECT_EQ(layout->unbuilt[0].begin, 1u);
  EXPECT_EQ(layout->unbuilt[0].end, 4u);
  EXPECT_THAT(layout->arrays.references, ElementsAre(7, 5, 6, 4));
  EXPECT_THAT(Counts(layout->arrays), ElementsAre(0, 1, 3));
  EXPECT_THAT(Offsets(layout->arrays), ElementsAre(2, 0, 1));
  EXPECT_EQ(layout->arrays.nodes[2].bounds, Box(1));
}

TEST(LayoutTest, NoNodesStayNone) {
  const auto context = std::make_shared<BuildContext>();
  const DeltaLeafTasks none({}, nullptr, nullptr, context);
  const absl::StatusOr<BinaryLayout> layout = LayOut(none, *context);
  ASSERT_TRUE(layout.ok());
  EXPECT_TRUE(layout->arrays.nodes.empty());
}

TEST(LayoutTest, CanBeCancelled) {
  const Parts parts;
  parts.context->Cancel();
  EXPECT_EQ(LayOut(parts.delta_leaves, *parts.context).status().code(), absl::StatusCode::kCancelled);
}

}  // namespace
}  // namespace deltaray
