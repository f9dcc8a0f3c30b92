// Choosing how to build a tree by what the mesh needs: the preset AUTO.

#ifndef SERVER_BUILD_AUTO_CONFIG_H_
#define SERVER_BUILD_AUTO_CONFIG_H_

#include <span>
#include <string>
#include <vector>

#include "server/build/build_context.h"
#include "server/build/config.h"
#include "server/build/reference.h"

namespace deltaray {

// A Config, and why it is so.
struct ChosenConfig {
  Config config;
  std::vector<std::string> reasons;  // a sentence for each choice
};

// The number of boxes of `references` that a random line which meets the box of all meets on average: the sum of their
// areas over its area. 0 where that box has no area. In parallel; the same for any number of threads.
double BoxesALineMeets(std::span<const Reference> references, BuildContext& context);

// Chooses what `wanted` leaves open, which is something only for the hybrid with Preset::kAuto; `wanted` itself else,
// without reasons.
//  - Spatial splits, where a line meets so many boxes that there must be much overlap to cut away.
//  - Eager, unless lazy is asked for.
//  - δ where it is kDeltaByMesh, and whether to cluster, by the number of triangles.
// `references`: of all triangles, none split yet.
ChosenConfig ChooseConfig(const Config& wanted, std::span<const Reference> references, BuildContext& context);

}  // namespace deltaray

#endif  // SERVER_BUILD_AUTO_CONFIG_H_
