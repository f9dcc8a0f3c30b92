// The options that say how to build a tree; `upload` and `rebuild` have them.

#ifndef CLIENT_BUILD_FLAGS_H_
#define CLIENT_BUILD_FLAGS_H_

#include <functional>

#include "CLI/App.hpp"
#include "deltaray/v1/mesh.pb.h"

namespace deltaray {

// Adds --preset, --builder, --delta, --alpha, --traversal-cost, --intersection-cost and --lazy. Those that are given
// set their field of options(); the others leave theirs unset. Where none is given, `options` is never called: a
// request without build options asks for something else than one with all of them unset. Ranges are the server's to
// check.
void AddBuildFlags(CLI::App& command, const std::function<v1::BuildOptions&()>& options);

}  // namespace deltaray

#endif  // CLIENT_BUILD_FLAGS_H_
