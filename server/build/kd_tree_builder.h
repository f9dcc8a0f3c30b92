// The SAH kd-tree: the first of the paper's baselines.

#ifndef SERVER_BUILD_KD_TREE_BUILDER_H_
#define SERVER_BUILD_KD_TREE_BUILDER_H_

#include <span>

#include "absl/status/statusor.h"
#include "server/build/build_context.h"
#include "server/build/config.h"
#include "server/build/reference.h"
#include "server/geometry/triangles.h"
#include "server/tree/kd_tree.h"

namespace deltaray {

// Splits space at planes where the SAH says (config.traversal_cost, intersection_cost), over all axes, with references
// clipped to their cell, down to where a leaf is cheaper. A plane that cuts off empty space costs a fifth less.
// Sources: [Wald and Havran 2006], [Wald 2007].
//
// Always ends, also for a fan of 20,000 triangles or 10,000 copies of one: no node is deeper than 8 + 1.3 log2(n)
// levels, two splits on a way down may cost more than the leaf that they replace, and splits add at most
// config.duplication_budget references per triangle, shared among subtrees in proportion to their references.
//
// The result does not depend on the number of threads. Runs in the calling thread's TBB arena, in parallel. Counts
// spatial_splits and references_placed in `context`, and polls it. CANCELLED where the build is; throws std::bad_alloc.
// No references: no nodes.
absl::StatusOr<KdArrays> BuildKdTree(std::span<const Reference> references, const TrianglesView& triangles,
                                     const Config& config, BuildContext& context);

}  // namespace deltaray

#endif  // SERVER_BUILD_KD_TREE_BUILDER_H_
