#include "server/build/layout.h"

#include <memory>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace deltaray {
namespace {

using testing::ElementsAre;

Bounds Box(float size) { return {{0, 0, 0}, {size, size, size}}; }

// A top of two δ-leaves: the first becomes a leaf, the second two leaves.
std::unique_ptr<ProvisionalTree> MakeTree() {
  BvhArrays top{{{Box(4), 2, 0}, {Box(2), 0, 1}, {Box(3), 1, 3}}, {7, 5, 6, 4}};
  auto tree = std::make_unique<ProvisionalTree>(TrianglesView(), std::move(top));
  // The order in which they come makes no difference.
  tree->PublishDeltaLeaf(
      1, std::make_unique<BvhArrays>(BvhArrays{{{Box(3), 2, 0}, {Box(1), 0, 2}, {Box(1.5), 2, 1}}, {6, 4, 5}}));
  tree->PublishDeltaLeaf(0, std::make_unique<BvhArrays>(BvhArrays{{{Box(2), 0, 1}}, {7}}));
  return tree;
}

TEST(LayoutTest, DeltaLeavesStandWhereTheTopHadThem) {
  BuildContext context;
  const absl::StatusOr<BvhArrays> arrays = LayOut(*MakeTree(), context);
  ASSERT_TRUE(arrays.ok());
  EXPECT_THAT(arrays->references, ElementsAre(7, 6, 4, 5));
  std::vector<uint32_t> offsets, counts;
  for (const BvhNode& node : arrays->nodes) {
    offsets.push_back(node.offset);
    counts.push_back(node.count);
  }
  EXPECT_THAT(counts, ElementsAre(0, 1, 0, 2, 1));
  EXPECT_THAT(offsets, ElementsAre(2, 0, 4, 1, 3));
  EXPECT_EQ(arrays->nodes[0].bounds, Box(4));
  EXPECT_EQ(arrays->nodes[4].bounds, Box(1.5));
}

TEST(LayoutTest, NoNodesStayNone) {
  BuildContext context;
  const absl::StatusOr<BvhArrays> arrays = LayOut(ProvisionalTree(TrianglesView(), BvhArrays()), context);
  ASSERT_TRUE(arrays.ok());
  EXPECT_TRUE(arrays->nodes.empty());
}

TEST(LayoutTest, CanBeCancelled) {
  BuildContext context;
  context.Cancel();
  EXPECT_EQ(LayOut(*MakeTree(), context).status().code(), absl::StatusCode::kCancelled);
}

}  // namespace
}  // namespace deltaray
