// One tree from its parts.

#ifndef SERVER_BUILD_LAYOUT_H_
#define SERVER_BUILD_LAYOUT_H_

#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "server/build/build_context.h"
#include "server/build/delta_leaf_tasks.h"
#include "server/tree/bvh.h"

namespace deltaray {

// The top with each δ-leaf's BVH in the place of the δ-leaf, or, where that is not built, the tree of GroupReferences:
// one BVH in depth-first order, `arrays`. Where things stand depends on the parts alone, not on when they were built.
struct BinaryLayout {
  BvhArrays arrays;
  // By δ-leaf that is not built, in order: it, and its place in arrays.references.
  struct Unbuilt {
    uint32_t delta_leaf = 0;
    uint32_t begin = 0, end = 0;
  };
  std::vector<Unbuilt> unbuilt;
};

// In parallel, in the calling thread's TBB arena, while other threads may build δ-leaves. CANCELLED where the build is;
// throws std::bad_alloc.
absl::StatusOr<BinaryLayout> LayOut(const DeltaLeafTasks& delta_leaves, BuildContext& context);

}  // namespace deltaray

#endif  // SERVER_BUILD_LAYOUT_H_
