#include "server/build/delta_leaf_tasks.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <utility>

namespace deltaray {

DeltaLeafTasks::DeltaLeafTasks(SplitTree top, BuildOne build_one, std::function<void()> on_delta_leaf,
                               std::shared_ptr<BuildContext> context)
    : context_(std::move(context)),
      references_(std::move(top.references)),
      build_one_(std::move(build_one)),
      on_delta_leaf_(std::move(on_delta_leaf)) {
  if (!top.nodes.empty()) mesh_bounds_ = top.nodes[0].bounds;
  for (const BvhNode& node : top.nodes) {
    if (node.IsLeaf()) delta_leaves_.push_back({node.offset, node.count});
  }
  begun_ = std::vector<std::atomic<bool>>(delta_leaves_.size());
}

void DeltaLeafTasks::BuildAndPublish(uint32_t delta_leaf, ProvisionalTree& tree) {
  if (begun_[delta_leaf].exchange(true, std::memory_order_relaxed)) return;
  if (on_delta_leaf_) on_delta_leaf_();
  if (context_->cancelled()) return;
  const auto [offset, count] = delta_leaves_[delta_leaf];
  auto subtree = std::make_unique<BvhArrays>(build_one_(references_.span().subspan(offset, count), mesh_bounds_));
  if (context_->cancelled()) return;
  tree.PublishDeltaLeaf(delta_leaf, std::move(subtree));
  context_->delta_leaves_built.fetch_add(1, std::memory_order_relaxed);
}

absl::Status DeltaLeafTasks::BuildAndPublishAll(ProvisionalTree& tree) {
  tbb::parallel_for(tbb::blocked_range<uint32_t>(0, static_cast<uint32_t>(delta_leaves_.size())),
                    [&](const tbb::blocked_range<uint32_t>& range) {
                      const BuildContext::CpuTime time(*context_);
                      for (uint32_t i = range.begin(); i < range.end() && !context_->cancelled(); ++i) {
                        BuildAndPublish(i, tree);
                      }
                    });
  return context_->cancelled() ? absl::CancelledError("the build was cancelled") : absl::OkStatus();
}

}  // namespace deltaray
