// The bytes of a wide tree from a binary one.

#ifndef SERVER_BUILD_WIDE_LAYOUT_H_
#define SERVER_BUILD_WIDE_LAYOUT_H_

#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "server/build/build_context.h"
#include "server/geometry/triangles.h"
#include "server/tree/bvh.h"
#include "server/tree/simd_target.h"
#include "server/tree/wide_arrays.h"

namespace deltaray {

// Collapses `tree` to nodes as wide as `target` has lanes (WidePlan) and lays them out. In parallel, in the calling
// thread's TBB arena; the bytes do not depend on the number of threads. A leaf has each triangle once, in order of ids.
//
// CANCELLED where the build is. RESOURCE_EXHAUSTED where the tree or the ids do not fit in WideArrays; throws
// std::bad_alloc. REQUIRES: leaves of at most kMaxLeafTriangles references, each the next ones of tree.references.
//
// Where `leaf_references` is given, it becomes, by unit of the block, which of tree.references the leaf that begins
// there is made of; count 0: none does.
struct LeafReferences {
  uint32_t begin = 0, count = 0;
};
absl::StatusOr<WideArrays> LayOutWide(const BvhArrays& tree, const TrianglesView& triangles, SimdTarget target,
                                      BuildContext& context, std::vector<LeafReferences>* leaf_references = nullptr);

}  // namespace deltaray

#endif  // SERVER_BUILD_WIDE_LAYOUT_H_
