// Builds the δ-leaves of a top, each on its own and once.

#ifndef SERVER_BUILD_DELTA_LEAF_TASKS_H_
#define SERVER_BUILD_DELTA_LEAF_TASKS_H_

#include <atomic>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "absl/status/status.h"
#include "server/build/build_context.h"
#include "server/build/reference.h"
#include "server/build/top_down.h"
#include "server/tree/bvh.h"
#include "server/tree/provisional_tree.h"

namespace deltaray {

// Holds what it takes to build the δ-leaves of one tree. Thread-safe.
class DeltaLeafTasks {
 public:
  // Builds one δ-leaf. Called from many threads at once.
  using BuildOne = std::function<BvhArrays(std::span<const Reference> references, const Bounds& mesh_bounds)>;

  // `on_delta_leaf` may be null; see Build::Options.
  DeltaLeafTasks(SplitTree top, BuildOne build_one, std::function<void()> on_delta_leaf,
                 std::shared_ptr<BuildContext> context);

  // Builds the δ-leaf and publishes it in `tree`, unless that was begun before.
  void BuildAndPublish(uint32_t delta_leaf, ProvisionalTree& tree);

  // Does so for all δ-leaves, each as a task of the calling thread's TBB arena. CANCELLED where the build is.
  absl::Status BuildAndPublishAll(ProvisionalTree& tree);

 private:
  struct DeltaLeaf {
    uint32_t offset, count;  // in references_
  };

  const std::shared_ptr<BuildContext> context_;  // before references_, which count in it
  const ReferenceArray references_;
  const BuildOne build_one_;
  const std::function<void()> on_delta_leaf_;
  Bounds mesh_bounds_;
  std::vector<DeltaLeaf> delta_leaves_;
  std::vector<std::atomic<bool>> begun_;
};

}  // namespace deltaray

#endif  // SERVER_BUILD_DELTA_LEAF_TASKS_H_
