// Builds the tree of a mesh, asynchronously.

#ifndef SERVER_BUILD_BUILD_H_
#define SERVER_BUILD_BUILD_H_

#include <functional>
#include <memory>
#include <optional>

#include "absl/status/status.h"
#include "server/build/config.h"
#include "server/build/statistics.h"
#include "server/mesh/triangle_mesh.h"
#include "server/tree/simd_target.h"
#include "server/tree/tree.h"

namespace deltaray {

// What queries may use of a build: a tree with all that it needs to live.
struct TreeSnapshot {
  std::shared_ptr<const TriangleMesh> mesh;
  std::shared_ptr<const Tree> tree;  // keeps `mesh` alive too
  bool final = false;                // whether this is the final tree
};

// One build of one mesh. All methods are thread-safe.
//
// States: created -> running -> (provisional) -> done or cancelled or failed. A baseline (every builder but the hybrid
// and [Tang 2015]) has no provisional tree, nor has Preset::kFast. A lazy build is done once the top stands.
class Build {
 public:
  struct Options {
    Config config;
    // Threads to build with; 0: all cores.
    uint32_t threads = 0;
    // Called at every δ-leaf before it is built, from the building thread; for tests that need a slow build.
    std::function<void()> on_delta_leaf;
    // What the final tree is laid out for, one of SupportedSimdTargets(). Default: the widest.
    std::optional<SimdTarget> simd_target = std::nullopt;
  };

  // Starts to build in the background and returns at once.
  // REQUIRES: Validate(options.config).ok().
  static std::shared_ptr<Build> Start(std::shared_ptr<const TriangleMesh> mesh, Options options);

  // Cancels and waits: no task of this build runs once it is destroyed. Snapshots stay valid.
  virtual ~Build() = default;

  // The tree to query now: nothing, the provisional or the final one.
  virtual std::shared_ptr<const TreeSnapshot> snapshot() const = 0;

  // Blocks until rays can be answered, or the build has ended. OK: snapshot() is set.
  virtual absl::Status WaitProvisional() = 0;
  // Blocks until the build has ended. CANCELLED after Cancel().
  virtual absl::Status WaitDone() = 0;

  // Asks the build to end; it does so within 100 ms. Nothing happens where it has ended already.
  virtual void Cancel() = 0;

  virtual BuildProgress progress() const = 0;
  virtual BuildStatistics statistics() const = 0;
};

}  // namespace deltaray

#endif  // SERVER_BUILD_BUILD_H_
