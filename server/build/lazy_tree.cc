#include "server/build/lazy_tree.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <exception>
#include <functional>
#include <utility>

#include "server/build/layout.h"
#include "server/build/wide_layout.h"
#include "server/tree/wide_node.h"

namespace deltaray {
namespace {

using Clock = std::chrono::steady_clock;

// Which δ-leaf that is not built each leaf holds references of; the first one where there are several.
std::vector<std::atomic<uint32_t>> LabelsOf(std::span<const LeafReferences> leaves,
                                            std::span<const BinaryLayout::Unbuilt> unbuilt) {
  std::vector<std::atomic<uint32_t>> labels(leaves.size());
  for (size_t i = 0; i < labels.size(); ++i) {
    const auto [begin, count] = leaves[i];
    const auto found = std::upper_bound(unbuilt.begin(), unbuilt.end(), begin,
                                        [](uint32_t reference, const auto& u) { return reference < u.end; });
    const bool holds = count != 0 && found != unbuilt.end() && found->begin < begin + count;
    labels[i].store(holds ? found->delta_leaf : LeafRecorder::kNoLabel, std::memory_order_relaxed);
  }
  return labels;
}

}  // namespace

absl::StatusOr<std::shared_ptr<const LazyTree::Version>> LazyTree::LayOutVersion(
    const TrianglesView& triangles, const std::shared_ptr<DeltaLeafTasks>& tasks, SimdTarget target,
    BuildContext& context) {
  const Clock::time_point start = Clock::now();
  const absl::StatusOr<BinaryLayout> binary = LayOut(*tasks, context);
  if (!binary.ok()) return binary.status();
  std::vector<LeafReferences> leaf_references;
  absl::StatusOr<WideArrays> wide = LayOutWide(binary->arrays, triangles, target, context, &leaf_references);
  if (!wide.ok()) return wide.status();
  const bool complete = binary->unbuilt.empty();
  return std::make_shared<const Version>(Version{
      WideTree(triangles, *std::move(wide)), LabelsOf(leaf_references, binary->unbuilt), complete ? nullptr : tasks,
      tasks->count() - binary->unbuilt.size(), (Clock::now() - start) * tbb::this_task_arena::max_concurrency()});
}

LazyTree::LazyTree(TrianglesView triangles, std::shared_ptr<const Version> first, SimdTarget target,
                   std::shared_ptr<BuildContext> context)
    : triangles_(triangles), target_(target), context_(std::move(context)), version_(std::move(first)) {}

template <typename Query>
void LazyTree::Answer(const QueryOptions& options, const Query& query) const {
  const std::shared_ptr<const Version> version = version_.load();
  if (version->tasks == nullptr) return query(version->tree, options);
  // Asked within the query only: what it has answered by then stands, however long the rest takes.
  bool was_stopped = false;
  const std::function<bool()> stopped = [&] { return was_stopped = was_stopped || (*options.stopped)(); };
  QueryOptions asking = options;
  if (options.stopped != nullptr) asking.stopped = &stopped;
  const bool is_behind = context_->delta_leaves_built.load(std::memory_order_relaxed) > version->delta_leaves;
  const Clock::time_point start = is_behind ? Clock::now() : Clock::time_point();
  std::vector<LeafRecorder::Leaf> reached;
  {
    LeafRecorder recorder(version->tree.arrays(), version->labels);
    query(version->tree, asking);
    reached = recorder.Take();
  }
  if (was_stopped) return LeaveUnbuilt(*version, reached);
  if (is_behind) {
    const int64_t time = std::chrono::nanoseconds(Clock::now() - start).count();
    const int64_t sum = nanoseconds_traced_.fetch_add(time, std::memory_order_relaxed) + time;
    if (sum >= kTracingPerLayout * version->layout_cost.count()) LayOutAnew(*version);
  }
  if (!reached.empty()) BuildReached(*version, reached);
}

void LazyTree::BuildReached(const Version& version, std::span<const LeafRecorder::Leaf> reached) const {
  const BuildContext::CpuTime time(*context_, BuildPhase::kDeltaLeaves);
  DeltaLeafTasks& tasks = *version.tasks;
  size_t done = 0;
  try {
    for (; done < reached.size(); ++done) {
      // A leaf of the tree may hold several small ones, which follow each other.
      uint32_t delta_leaf = reached[done].label;
      size_t references = 0;
      do {
        references += tasks.references(delta_leaf).size();
        tasks.Build(delta_leaf++);
      } while (delta_leaf < tasks.count() && references + tasks.references(delta_leaf).size() <= kMaxLeafTriangles);
    }
  } catch (const std::exception&) {
    LeaveUnbuilt(version, reached.subspan(done));
  }
}

void LazyTree::LeaveUnbuilt(const Version& version, std::span<const LeafRecorder::Leaf> reached) const {
  for (const LeafRecorder::Leaf& leaf : reached) {
    version.labels[leaf.unit].store(leaf.label, std::memory_order_relaxed);
  }
}

void LazyTree::LayOutAnew(const Version& version) const {
  if (is_laying_out_.exchange(true, std::memory_order_acquire)) return;
  // Another thread may have done it since.
  if (version_.load().get() == &version) {
    try {
      // Isolated, so that this thread, while it waits, does not take up a task that traces.
      auto next =
          tbb::this_task_arena::isolate([&] { return LayOutVersion(triangles_, version.tasks, target_, *context_); });
      if (next.ok()) Replace(*std::move(next));
    } catch (const std::exception&) {
      // The one before goes on.
    }
    nanoseconds_traced_.store(0, std::memory_order_relaxed);
  }
  is_laying_out_.store(false, std::memory_order_release);
}

std::shared_ptr<const LazyTree::Version> LazyTree::Replace(std::shared_ptr<const Version> version) const {
  return version_.exchange(std::move(version));
}

void LazyTree::ClosestHits(std::span<const Ray> rays, const QueryOptions& options, std::span<Hit> hits) const {
  Answer(options, [&](const WideTree& tree, const QueryOptions& asking) { tree.ClosestHits(rays, asking, hits); });
}

void LazyTree::AnyHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint8_t> any) const {
  Answer(options, [&](const WideTree& tree, const QueryOptions& asking) { tree.AnyHits(rays, asking, any); });
}

void LazyTree::AllHits(std::span<const Ray> rays, const QueryOptions& options, std::vector<Hit>* hits,
                       std::span<uint32_t> counts) const {
  Answer(options, [&](const WideTree& tree, const QueryOptions& asking) { tree.AllHits(rays, asking, hits, counts); });
}

void LazyTree::CountHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint32_t> counts) const {
  Answer(options, [&](const WideTree& tree, const QueryOptions& asking) { tree.CountHits(rays, asking, counts); });
}

TreeShape LazyTree::Shape() const { return version_.load()->tree.Shape(); }

}  // namespace deltaray
