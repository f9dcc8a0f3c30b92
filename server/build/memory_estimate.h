// How much memory a build will take, before it begins.

#ifndef SERVER_BUILD_MEMORY_ESTIMATE_H_
#define SERVER_BUILD_MEMORY_ESTIMATE_H_

#include <cstdint>

#include "server/build/config.h"

namespace deltaray {

// At least as many bytes as a build takes at its peak, the finished tree included and the mesh not; of a lazy one as
// many as its tree takes at any time, until all of it is built. From peaks that were measured
// (tests/unit/bench/build_memory_test.cc asks the system again): what the builders hold for each reference, for as many
// references as the config lets spatial splits make, in δ-leaves of half of δ. Most meshes take less: few
// use their room for references.
uint64_t EstimateBuildBytes(const Config& config, uint64_t triangles);

}  // namespace deltaray

#endif  // SERVER_BUILD_MEMORY_ESTIMATE_H_
