// Wide trees over small scenes, and all that rays can be asked of them.

#ifndef TESTS_UNIT_TREE_WIDE_TREES_H_
#define TESTS_UNIT_TREE_WIDE_TREES_H_

#include <utility>

#include "gtest/gtest.h"
#include "server/build/build_context.h"
#include "server/build/wide_layout.h"
#include "server/tree/wide_tree.h"
#include "tests/unit/tree/small_trees.h"

namespace deltaray {

inline constexpr Traversal kTraversals[] = {Traversal::kAuto, Traversal::kSingle, Traversal::kBatch, Traversal::kPacket,
                                            Traversal::kStream};
inline constexpr AccuracyLevel kLevels[] = {AccuracyLevel::kFast, AccuracyLevel::kWatertight, AccuracyLevel::kExact};

inline WideTree MakeWide(const TrianglesView& triangles, size_t leaf_size, int spatial, SimdTarget target) {
  BuildContext context;
  absl::StatusOr<WideArrays> arrays = LayOutWide(MakeBvh(triangles, leaf_size, spatial), triangles, target, context);
  EXPECT_TRUE(arrays.ok()) << arrays.status();
  return WideTree(triangles, *std::move(arrays));
}

}  // namespace deltaray

#endif  // TESTS_UNIT_TREE_WIDE_TREES_H_
