// Top-down building by splits: the hybrid's top down to δ-leaves, and the whole of the BVH and the SBVH.

#ifndef SERVER_BUILD_TOP_DOWN_H_
#define SERVER_BUILD_TOP_DOWN_H_

#include <vector>

#include "absl/status/statusor.h"
#include "server/build/build_context.h"
#include "server/build/config.h"
#include "server/build/reference.h"
#include "server/geometry/triangles.h"
#include "server/tree/bvh.h"

namespace deltaray {

// A tree of splits over references.
struct SplitTree {
  // As in BvhArrays: depth-first; the leaves' ranges of `references` follow each other without gaps.
  BvhNodes nodes;
  ReferenceArray references;
};

// No node of BuildTopDown's trees is deeper: from kSahDepth on, splits are at the median.
inline constexpr uint32_t kSahDepth = 64;
inline constexpr uint32_t kMaxTopDownDepth = kSahDepth + 32;

// Splits down to nodes of at most config.delta references, the δ-leaves. Each node is split where the SAH says, by
// objects or, where the children of the best object split overlap enough, in space [Stich 2009]. Differs from
// [Tang 2015], table 1, in that choice, in looking at all three axes, in clipping references to their cell, in δ
// references being few enough, and in that it always ends.
//
// References that spatial splits add go in the room that `references` has; what room a node has is shared among its
// children in proportion to their references. The result does not depend on the number of threads. Runs in the calling
// thread's TBB arena. CANCELLED where the build is; throws std::bad_alloc.
absl::StatusOr<SplitTree> BuildTop(ReferenceArray references, const TrianglesView& triangles, const Config& config,
                                   BuildContext& context);

// The same down to leaves: a node of at most config.max_leaf_size references is a leaf where splitting it would not
// make it cheaper.
absl::StatusOr<SplitTree> BuildTopDown(ReferenceArray references, const TrianglesView& triangles, const Config& config,
                                       BuildContext& context);

// The tree of a SplitTree's nodes and of the primitives of its references.
BvhArrays ToBvhArrays(const SplitTree& tree);

}  // namespace deltaray

#endif  // SERVER_BUILD_TOP_DOWN_H_
