// The final tree from its parts.

#ifndef SERVER_BUILD_LAYOUT_H_
#define SERVER_BUILD_LAYOUT_H_

#include "absl/status/statusor.h"
#include "server/build/build_context.h"
#include "server/tree/bvh.h"
#include "server/tree/provisional_tree.h"

namespace deltaray {

// The top with each δ-leaf's BVH in the place of the δ-leaf: one BVH in depth-first order. Where things stand depends
// on the parts alone, not on when they were built. In parallel, in the calling thread's TBB arena. CANCELLED where the
// build is; throws std::bad_alloc. REQUIRES: all δ-leaves are built.
absl::StatusOr<BvhArrays> LayOut(const ProvisionalTree& tree, BuildContext& context);

}  // namespace deltaray

#endif  // SERVER_BUILD_LAYOUT_H_
