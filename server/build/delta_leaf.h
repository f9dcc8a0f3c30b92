// Builds a δ-leaf: the best of several small trees over its references.

#ifndef SERVER_BUILD_DELTA_LEAF_H_
#define SERVER_BUILD_DELTA_LEAF_H_

#include <span>

#include "server/build/build_context.h"
#include "server/build/config.h"
#include "server/build/reference.h"
#include "server/geometry/bounds.h"
#include "server/tree/bvh.h"

namespace deltaray {

// Builds the BVH of `references` by each candidate of the preset, down to leaves of one, and keeps the one of least SAH
// cost once leaves of up to config.max_leaf_size are made where they pay; counts its win in `context`. Which leaves the
// finished tree has, WidePlan decides; but with Preset::kFast what fits in a leaf is one leaf. Differs from [Tang
// 2015], which has the first candidate alone and distances in the mesh's unit. `mesh_bounds`: the box of all references
// of the mesh. Anything where the build is cancelled. REQUIRES: references is not empty.
BvhArrays BuildDeltaLeaf(std::span<const Reference> references, const Bounds& mesh_bounds, const Config& config,
                         BuildContext& context);

}  // namespace deltaray

#endif  // SERVER_BUILD_DELTA_LEAF_H_
