// The options that say how to build a tree; `upload` and `rebuild` have them.

#ifndef CLIENT_BUILD_FLAGS_H_
#define CLIENT_BUILD_FLAGS_H_

#include "CLI/App.hpp"
#include "deltaray/v1/mesh.pb.h"

namespace deltaray {

// Adds --preset, --builder, --delta, --alpha, --traversal-cost, --intersection-cost and --lazy. Those that are given
// set their field of `options`, which must live as long as the command; the others leave theirs unset. Ranges are the
// server's to check.
void AddBuildFlags(CLI::App& command, v1::BuildOptions& options);

}  // namespace deltaray

#endif  // CLIENT_BUILD_FLAGS_H_
