// Follows the build of a mesh's tree.

#ifndef CLIENT_BUILD_WATCHER_H_
#define CLIENT_BUILD_WATCHER_H_

#include <string>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "client/connection.h"

namespace deltaray {

// Watches until the tree is final (provisional, where it is built lazily), with a progress bar where the session shows
// them, and hands each report to `report`. A LocalError where the build failed.
absl::Status WatchBuild(Connection& connection, const Session& session, const std::string& mesh,
                        absl::FunctionRef<absl::Status(const v1::WatchBuildResponse&)> report);

// The same without reports.
absl::Status WatchBuild(Connection& connection, const Session& session, const std::string& mesh);

// Part of a build that is done, 0 to 1: half for the top, half for the δ-leaves.
double BuildFraction(const v1::BuildProgress& progress);

// "δ-leaves: 1,200 of 3,400".
std::string BuildText(const v1::BuildProgress& progress);

}  // namespace deltaray

#endif  // CLIENT_BUILD_WATCHER_H_
