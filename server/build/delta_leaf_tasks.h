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
#include "server/tree/large_memory.h"

namespace deltaray {

// The BVH of a δ-leaf: as BvhArrays.
struct DeltaLeafTree {
  std::span<const BvhNode> nodes;
  std::span<const uint32_t> references;
};

// The top of one tree, and its δ-leaves: the references of each, and its BVH once that is built. δ-leaves are numbered
// in the order of the leaves in top(). Thread-safe.
class DeltaLeafTasks {
 public:
  // Builds one δ-leaf. Called from many threads at once.
  using BuildOne = std::function<BvhArrays(std::span<const Reference> references, const Bounds& mesh_bounds)>;

  // `on_delta_leaf` may be null; see Build::Options.
  DeltaLeafTasks(SplitTree top, BuildOne build_one, std::function<void()> on_delta_leaf,
                 std::shared_ptr<BuildContext> context);

  // A BVH each of whose leaves is one δ-leaf.
  std::span<const BvhNode> top() const { return top_.nodes; }
  uint32_t count() const { return static_cast<uint32_t>(delta_leaves_.size()); }
  std::span<const Reference> references(uint32_t delta_leaf) const;
  // The δ-leaf's BVH, whose leaves hold primitive ids; no nodes: it is not built yet. Once it is, it stays.
  DeltaLeafTree built(uint32_t delta_leaf) const;

  // Builds the δ-leaf, unless that was begun before.
  void Build(uint32_t delta_leaf);

  // Does so for all δ-leaves, each as a task of the calling thread's TBB arena. CANCELLED where the build is.
  absl::Status BuildAll();

 private:
  struct DeltaLeaf {
    uint32_t offset = 0, count = 0;  // in the top's references
    std::atomic<bool> begun{false};
    uint32_t first_node = 0;         // in nodes_
    std::atomic<uint32_t> nodes{0};  // 0: not built
  };

  const std::shared_ptr<BuildContext> context_;  // before top_, whose references count in it
  const SplitTree top_;
  const BuildOne build_one_;
  const std::function<void()> on_delta_leaf_;
  std::vector<DeltaLeaf> delta_leaves_;
  // The δ-leaves' trees stand together, since memory of its own for each is a page fault for each page. One of n
  // references has at most 2n - 1 nodes. What is not written takes no memory.
  LargeArray<BvhNode> nodes_;        // one tree after the other, as they were built
  LargeArray<uint32_t> references_;  // where they stand in the top's references
  std::atomic<uint32_t> nodes_used_{0};
};

}  // namespace deltaray

#endif  // SERVER_BUILD_DELTA_LEAF_TASKS_H_
