// [Tang 2015] as printed: Tang Yu, Yu Fang, Sun Yong, Wang Danni: Research on Bottom-Up Approach to Build an Effective
// BVH. Kept as a baseline; what the hybrid does otherwise is told where it does it.

#ifndef SERVER_BUILD_TANG2015_BUILDER_H_
#define SERVER_BUILD_TANG2015_BUILDER_H_

#include <span>

#include "absl/status/statusor.h"
#include "server/build/build_context.h"
#include "server/build/config.h"
#include "server/build/reference.h"
#include "server/build/top_down.h"
#include "server/geometry/bounds.h"
#include "server/tree/bvh.h"

namespace deltaray {

// Table 1, down to nodes of fewer than δ references (of one, where δ is 1: no node has fewer): the axis is the widest
// one of the box round the node's primitives, as far as it lies in the node's cell; the position on it is the best one
// by the standard SAH of config.traversal_cost and intersection_cost (above 1,024 references, of 63 at even distances);
// and a primitive whose box overlaps both halves is referenced, whole box and all, in both. A box overlaps a half where
// they share more than a face.
//
// Not as printed, since that does not end where δ primitives meet in a spot, and since on uneven scenes it fills the
// memory: a split gives way to an object split, and that to the median, where a child would have as many references as
// its parent, where it needs more room than the node has left in `references` (shared in proportion to the children's
// references), and at depths from kSahDepth on. No node is deeper than kMaxTopDownDepth.
//
// Counts splits by kind and δ-leaves (CountDeltaLeaf, references_placed) in `context`, and polls it. A node's bounds
// are its cell, as printed: half of its parent's. The result does not depend on the number of threads. Runs in the
// calling thread's TBB arena, in parallel. CANCELLED where the build is; throws std::bad_alloc. No references: no
// nodes.
absl::StatusOr<SplitTree> BuildTang2015Top(ReferenceArray references, const Config& config, BuildContext& context);

// Table 2, for the references of one δ-leaf: clusters them by the cost of config.alpha, cluster_traversal_cost and
// cluster_intersection_cost, with distances in the mesh's unit, into a BVH with one reference a leaf. Anything where
// the build is cancelled. `mesh_bounds`: the box of all references of the mesh. REQUIRES: references is not empty.
BvhArrays BuildTang2015DeltaLeaf(std::span<const Reference> references, const Bounds& mesh_bounds, const Config& config,
                                 const BuildContext& context);

}  // namespace deltaray

#endif  // SERVER_BUILD_TANG2015_BUILDER_H_
