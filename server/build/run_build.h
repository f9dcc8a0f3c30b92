// The phases of a build, one after the other.

#ifndef SERVER_BUILD_RUN_BUILD_H_
#define SERVER_BUILD_RUN_BUILD_H_

#include <functional>
#include <memory>

#include "absl/status/statusor.h"
#include "server/build/build.h"
#include "server/build/build_context.h"
#include "server/mesh/triangle_mesh.h"
#include "server/tree/tree.h"

namespace deltaray {

// Builds the tree of `mesh` as options.config says and returns the final one; it keeps `mesh` alive. On the way, a
// hybrid gives its provisional tree to `publish_provisional`. A lazy build's final tree is a LazyTree, which
// keeps `context` and goes on counting in it.
//
// Runs in the calling thread's TBB arena. CANCELLED where the context is; throws std::bad_alloc.
absl::StatusOr<std::shared_ptr<const Tree>> RunBuild(
    const std::shared_ptr<const TriangleMesh>& mesh, const Build::Options& options,
    const std::shared_ptr<BuildContext>& context,
    const std::function<void(std::shared_ptr<const Tree>)>& publish_provisional);

}  // namespace deltaray

#endif  // SERVER_BUILD_RUN_BUILD_H_
