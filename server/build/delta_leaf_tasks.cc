#include "server/build/delta_leaf_tasks.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <utility>

namespace deltaray {

DeltaLeafTasks::DeltaLeafTasks(SplitTree top, BuildOne build_one, std::function<void()> on_delta_leaf,
                               std::shared_ptr<BuildContext> context)
    : context_(std::move(context)),
      top_(std::move(top)),
      build_one_(std::move(build_one)),
      on_delta_leaf_(std::move(on_delta_leaf)),
      delta_leaves_(std::count_if(top_.nodes.begin(), top_.nodes.end(), [](const BvhNode& n) { return n.IsLeaf(); })),
      nodes_(2 * top_.references.size()),
      references_(top_.references.size()) {
  auto next = delta_leaves_.begin();
  for (const BvhNode& node : top_.nodes) {
    if (!node.IsLeaf()) continue;
    next->offset = node.offset;
    next->count = node.count;
    ++next;
  }
}

std::span<const Reference> DeltaLeafTasks::references(uint32_t delta_leaf) const {
  return top_.references.span().subspan(delta_leaves_[delta_leaf].offset, delta_leaves_[delta_leaf].count);
}

DeltaLeafTree DeltaLeafTasks::built(uint32_t delta_leaf) const {
  const DeltaLeaf& task = delta_leaves_[delta_leaf];
  const uint32_t nodes = task.nodes.load(std::memory_order_acquire);
  if (nodes == 0) return {};
  return {{&nodes_[task.first_node], nodes}, {&references_[task.offset], task.count}};
}

void DeltaLeafTasks::Build(uint32_t delta_leaf) {
  DeltaLeaf& task = delta_leaves_[delta_leaf];
  if (task.begun.exchange(true, std::memory_order_relaxed)) return;
  BvhArrays tree;
  try {
    if (on_delta_leaf_) on_delta_leaf_();
    if (context_->cancelled()) return;
    tree = build_one_(references(delta_leaf), top_.nodes[0].bounds);
  } catch (...) {
    // For want of memory: of a lazy tree, the next ray that comes here tries again.
    task.begun.store(false, std::memory_order_relaxed);
    throw;
  }
  if (context_->cancelled()) return;
  const auto nodes = static_cast<uint32_t>(tree.nodes.size());
  task.first_node = nodes_used_.fetch_add(nodes, std::memory_order_relaxed);
  std::copy(tree.nodes.begin(), tree.nodes.end(), &nodes_[task.first_node]);
  std::copy(tree.references.begin(), tree.references.end(), &references_[task.offset]);
  // Release: a thread that sees the number sees the tree.
  task.nodes.store(nodes, std::memory_order_release);
  context_->delta_leaves_built.fetch_add(1, std::memory_order_relaxed);
}

absl::Status DeltaLeafTasks::BuildAll() {
  tbb::parallel_for(tbb::blocked_range<uint32_t>(0, count()), [&](const tbb::blocked_range<uint32_t>& range) {
    const BuildContext::CpuTime time(*context_);
    for (uint32_t i = range.begin(); i < range.end() && !context_->cancelled(); ++i) Build(i);
  });
  return context_->cancelled() ? absl::CancelledError("the build was cancelled") : absl::OkStatus();
}

}  // namespace deltaray
