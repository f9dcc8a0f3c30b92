// The tree of a lazy build: δ-leaves are built once rays have reached them.

#ifndef SERVER_BUILD_LAZY_TREE_H_
#define SERVER_BUILD_LAZY_TREE_H_

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/build/build_context.h"
#include "server/build/delta_leaf_tasks.h"
#include "server/geometry/triangles.h"
#include "server/tree/leaf_recorder.h"
#include "server/tree/simd_target.h"
#include "server/tree/tree.h"
#include "server/tree/wide_tree.h"

namespace deltaray {

// A wide tree that is laid out anew now and then. Queries record which δ-leaves that are not built rays have come to;
// whoever asked builds them before the query returns, each once. When the threads that trace have since
// taken kTracingPerLayout times what all threads take to lay out the tree, it is laid out with what is built, and
// replaces the one before; so that costs little however rays come. Once all δ-leaves are in the tree, it is the final
// tree of a build that is not lazy.
//
// Thread-safe; queries take no lock but the bit that guards an atomic shared_ptr. One that runs out of memory for
// δ-leaves or for a new tree answers from what there is.
class LazyTree final : public Tree {
 public:
  // One state of the tree.
  struct Version {
    WideTree tree;
    // For a LeafRecorder: the δ-leaf that a leaf is part of, where that is not built.
    mutable std::vector<std::atomic<uint32_t>> labels;
    std::shared_ptr<DeltaLeafTasks> tasks;   // nullptr: all δ-leaves are in the tree
    uint64_t delta_leaves = 0;               // that are built, in the tree
    std::chrono::nanoseconds layout_cost{};  // of all threads that it may have taken
  };
  // Lays out what is built. As LayOutWide.
  static absl::StatusOr<std::shared_ptr<const Version>> LayOutVersion(const TrianglesView& triangles,
                                                                      const std::shared_ptr<DeltaLeafTasks>& tasks,
                                                                      SimdTarget target, BuildContext& context);

  // `context` counts what is built. `triangles` must outlive the tree.
  LazyTree(TrianglesView triangles, std::shared_ptr<const Version> first, SimdTarget target,
           std::shared_ptr<BuildContext> context);

  void ClosestHits(std::span<const Ray> rays, const QueryOptions& options, std::span<Hit> hits) const override;
  void AnyHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint8_t> any) const override;
  void AllHits(std::span<const Ray> rays, const QueryOptions& options, std::vector<Hit>* hits,
               std::span<uint32_t> counts) const override;
  void CountHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint32_t> counts) const override;
  AccuracyLevel answered_accuracy(AccuracyLevel level) const override { return level; }
  bool is_growing() const override { return version_.load()->tasks != nullptr; }
  // Of the version that stands.
  TreeShape Shape() const override;

 private:
  static constexpr int kTracingPerLayout = 10;

  template <typename Query>
  void Answer(const QueryOptions& options, const Query& query) const;
  void BuildReached(const Version& version, std::span<const LeafRecorder::Leaf> reached) const;
  // They stay groups, which answer as well, until the next rays that come to them.
  void LeaveUnbuilt(const Version& version, std::span<const LeafRecorder::Leaf> reached) const;
  void LayOutAnew(const Version& version) const;
  // Returns the version that stood. Not inlined, so that tests/sanitizers/tsan.supp can name it.
  [[gnu::noinline]] std::shared_ptr<const Version> Replace(std::shared_ptr<const Version> version) const;

  const TrianglesView triangles_;
  const SimdTarget target_;
  const std::shared_ptr<BuildContext> context_;
  mutable std::atomic<std::shared_ptr<const Version>> version_;
  mutable std::atomic<int64_t> nanoseconds_traced_{0};  // with δ-leaves built that are not in the tree
  mutable std::atomic<bool> is_laying_out_{false};
};

}  // namespace deltaray

#endif  // SERVER_BUILD_LAZY_TREE_H_
