#include "server/build/group_references.h"

#include <algorithm>
#include <vector>

#include "gtest/gtest.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

TEST(GroupReferencesTest, MakesFullLeavesOfAllReferences) {
  for (const uint32_t count : {1, 7, 8, 9, 16, 17, 32, 1000}) {
    SCOPED_TRACE(count);
    std::vector<Reference> references = RandomReferences(count, 1);
    // Somewhere within larger arrays.
    BvhArrays arrays{BvhNodes(3 + GroupNodes(count)), std::vector<uint32_t>(5 + count)};
    const std::vector<Reference> given = references;
    GroupReferences(references, 3, 5, &arrays);

    std::vector<uint32_t> found;
    uint32_t leaves = 0, next_reference = 5;
    for (uint32_t i = 3; i < arrays.nodes.size(); ++i) {
      const BvhNode& node = arrays.nodes[i];
      if (!node.IsLeaf()) {
        EXPECT_EQ(node.bounds, Union(arrays.nodes[i + 1].bounds, arrays.nodes[node.offset].bounds));
        continue;
      }
      ++leaves;
      EXPECT_LE(node.count, kMaxLeafTriangles);
      EXPECT_EQ(node.offset, next_reference);
      next_reference += node.count;
      Bounds bounds;
      for (const uint32_t primitive : arrays.LeafReferences(node)) {
        found.push_back(primitive);
        bounds.Extend(given[primitive].bounds);
      }
      EXPECT_EQ(node.bounds, bounds);
    }
    EXPECT_EQ(leaves, (count + 7) / 8);
    EXPECT_EQ(arrays.nodes[3].bounds, UnionOf(given));
    std::sort(found.begin(), found.end());
    ASSERT_EQ(found.size(), count);
    for (uint32_t i = 0; i < count; ++i) EXPECT_EQ(found[i], i);
  }
}

TEST(GroupReferencesTest, NeighboursStayTogether) {
  // Two clusters far apart, of a group each, mixed.
  std::vector<Reference> references;
  for (uint32_t i = 0; i < 16; ++i) {
    const float x = i % 2 == 0 ? 0.0f : 100.0f;
    references.push_back({{{x, 0, 0}, {x + 1, 1, 1}}, i});
  }
  BvhArrays arrays{BvhNodes(GroupNodes(16)), std::vector<uint32_t>(16)};
  GroupReferences(references, 0, 0, &arrays);
  EXPECT_EQ(arrays.nodes[1].bounds.max.x, 1);
  EXPECT_EQ(arrays.nodes[2].bounds.min.x, 100);
}

}  // namespace
}  // namespace deltaray
