#include "server/build/sweep_builder.h"

#include <algorithm>

#include "gtest/gtest.h"
#include "server/build/collapse.h"
#include "server/build/top_down.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

TEST(SweepBuilderTest, EveryClusterIsMergedOnce) {
  BuildContext context;
  for (const uint32_t count : {1, 2, 3, 100}) {
    const Dendrogram dendrogram = SplitBySweeps(RandomReferences(count, count), context);
    ASSERT_EQ(dendrogram.size(), count - 1);
    std::vector<int> merged(2 * count - 1, 0);
    for (size_t i = 0; i < dendrogram.size(); ++i) {
      for (const uint32_t child : {dendrogram[i].left, dendrogram[i].right}) {
        ASSERT_LT(child, count + i);
        ++merged[child];
      }
    }
    EXPECT_EQ(std::count(merged.begin(), merged.end(), 1), 2 * count - 2);
  }
}

TEST(SweepBuilderTest, PartsTwoHeaps) {
  std::vector<Reference> references = RandomReferences(16, 1);
  for (size_t i = 0; i < references.size(); i += 2) {
    references[i].bounds.min.x += 100;
    references[i].bounds.max.x += 100;
  }
  BuildContext context;
  const Dendrogram dendrogram = SplitBySweeps(references, context);
  const CollapsedTree tree(references, dendrogram, SahCosts(Config()), 1);
  const BvhArrays arrays = tree.ToBvhArrays();
  EXPECT_LT(arrays.nodes[1].bounds.max.x, 2);
  EXPECT_GE(arrays.nodes[arrays.nodes[0].offset].bounds.min.x, 100);
}

// Each box is twice as large as the one before: the cheapest split peels off one at a time.
TEST(SweepBuilderTest, DepthIsBounded) {
  std::vector<Reference> references(250);
  for (uint32_t i = 0; i < references.size(); ++i) {
    const float size = std::ldexp(1.0f, static_cast<int>(i) - 125);
    references[i] = {{{0, 0, 0}, {size, size, size}}, i};
  }
  BuildContext context;
  const Dendrogram dendrogram = SplitBySweeps(references, context);
  const CollapsedTree tree(references, dendrogram, SahCosts(Config()), 1);
  EXPECT_GT(tree.depth(), 32u);
  EXPECT_LE(tree.depth(), kMaxTopDownDepth);
}

}  // namespace
}  // namespace deltaray
