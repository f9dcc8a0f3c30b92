#include "server/build/build.h"

#include <tbb/info.h>
#include <tbb/task_arena.h>

#include <exception>
#include <new>
#include <optional>
#include <system_error>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/build/build_context.h"
#include "server/build/mutex.h"
#include "server/build/run_build.h"

namespace deltaray {
namespace {

// What the Build and its thread share; outlives either.
class SharedState {
 public:
  explicit SharedState(std::shared_ptr<const TriangleMesh> mesh) : mesh_(std::move(mesh)) {}

  std::shared_ptr<const TreeSnapshot> snapshot() const {
    MutexLock lock(mutex_);
    return snapshot_;
  }

  double provisional_seconds() const {
    MutexLock lock(mutex_);
    return provisional_seconds_;
  }

  std::optional<TreeShape> final_shape() const {
    MutexLock lock(mutex_);
    return final_shape_;
  }

  void PublishProvisional(std::shared_ptr<const Tree> tree, double seconds) {
    {
      MutexLock lock(mutex_);
      snapshot_ = std::make_shared<TreeSnapshot>(TreeSnapshot{mesh_, std::move(tree), false});
      provisional_seconds_ = seconds;
    }
    changed_.notify_all();
  }

  // Not once it has ended: the δ-leaves of a lazy tree are built after that.
  void Cancel(BuildContext& context) {
    MutexLock lock(mutex_);
    if (!ended_) context.Cancel();
  }

  // `tree`: the final one, or null where `status` says why there is none.
  void End(absl::Status status, std::shared_ptr<const Tree> tree, const TreeShape& shape, const BuildContext& context) {
    std::shared_ptr<const TreeSnapshot> replaced;  // freed outside of the lock, as `tree` is
    {
      MutexLock lock(mutex_);
      // It may have come after the last look.
      if (status.ok() && context.cancelled()) status = absl::CancelledError("the build was cancelled");
      if (status.ok()) {
        replaced = std::exchange(snapshot_, std::make_shared<TreeSnapshot>(TreeSnapshot{mesh_, std::move(tree), true}));
        if (provisional_seconds_ == 0) provisional_seconds_ = context.elapsed_seconds();
        final_shape_ = shape;
      }
      ended_ = status;
    }
    changed_.notify_all();
  }

  absl::Status Wait(bool final) {
    MutexLock lock(mutex_);
    while (!ended_ && (final || snapshot_ == nullptr)) changed_.wait(mutex_);
    if (!final && snapshot_ != nullptr) return absl::OkStatus();
    return *ended_;
  }

 private:
  const std::shared_ptr<const TriangleMesh> mesh_;
  mutable Mutex mutex_;
  Condition changed_;
  std::shared_ptr<const TreeSnapshot> snapshot_ ABSL_GUARDED_BY(mutex_);
  double provisional_seconds_ ABSL_GUARDED_BY(mutex_) = 0;
  std::optional<TreeShape> final_shape_ ABSL_GUARDED_BY(mutex_);
  std::optional<absl::Status> ended_ ABSL_GUARDED_BY(mutex_);
};

// Runs the build from its first phase to its last, on the calling thread and the arena's workers.
void Lead(const std::shared_ptr<const TriangleMesh>& mesh, const Build::Options& options, int threads,
          const std::shared_ptr<BuildContext>& context, SharedState& state) {
  absl::Status status;
  std::shared_ptr<const Tree> tree;
  TreeShape shape;
  const auto publish_provisional = [&](std::shared_ptr<const Tree> provisional) {
    state.PublishProvisional(std::move(provisional), context->elapsed_seconds());
  };
  try {
    // One slot is this thread's own, so that the build goes on however busy the workers are. They come to it only where
    // no arena of normal priority, such as the one that traces, wants them.
    tbb::task_arena arena(threads, 1, tbb::task_arena::priority::low);
    arena.execute([&] {
      absl::StatusOr<std::shared_ptr<const Tree>> result = RunBuild(mesh, options, context, publish_provisional);
      status = result.status();
      if (!result.ok()) return;
      tree = *std::move(result);
      shape = tree->Shape();
    });
  } catch (const std::bad_alloc&) {
    status = absl::ResourceExhaustedError(
        absl::StrCat("not enough memory to build the tree of ", mesh->indices.size(), " triangles"));
  } catch (const std::exception& e) {
    status = absl::InternalError(absl::StrCat("the build failed: ", e.what()));
  }
  context->EnterPhase(BuildPhase::kDone);
  state.End(std::move(status), std::move(tree), shape, *context);
}

class AsynchronousBuild final : public Build {
 public:
  AsynchronousBuild(std::shared_ptr<const TriangleMesh> mesh, Options options)
      : config_(options.config),
        threads_(options.threads != 0 ? static_cast<int>(options.threads) : tbb::info::default_concurrency()),
        context_(std::make_shared<BuildContext>()),
        state_(std::make_shared<SharedState>(mesh)) {
    try {
      thread_ = std::thread([mesh, options = std::move(options), threads = threads_, context = context_,
                             state = state_] { Lead(mesh, options, threads, context, *state); });
    } catch (const std::system_error& e) {
      state_->End(absl::ResourceExhaustedError(absl::StrCat("no thread to build with: ", e.what())), nullptr, {},
                  *context_);
    }
  }

  ~AsynchronousBuild() override {
    Cancel();
    if (thread_.joinable()) thread_.join();
  }

  std::shared_ptr<const TreeSnapshot> snapshot() const override { return state_->snapshot(); }
  absl::Status WaitProvisional() override { return state_->Wait(false); }
  absl::Status WaitDone() override { return state_->Wait(true); }

  void Cancel() override { state_->Cancel(*context_); }

  BuildProgress progress() const override {
    return {.phase = context_->phase(),
            .references_placed = context_->references_placed,
            .triangles = context_->triangles,
            .delta_leaves = context_->delta_leaves,
            .delta_leaves_built = context_->delta_leaves_built,
            .lazy = context_->chosen_config().value_or(config_).lazy,
            .elapsed_seconds = context_->elapsed_seconds()};
  }

  BuildStatistics statistics() const override {
    BuildStatistics statistics;
    statistics.config = context_->chosen_config().value_or(config_);
    statistics.config.preset = config_.preset;
    statistics.choices = context_->choices();
    statistics.phases = context_->phases();
    statistics.provisional_seconds = state_->provisional_seconds();
    statistics.threads = static_cast<uint32_t>(threads_);
    statistics.triangles = context_->triangles;
    statistics.spatial_splits = context_->spatial_splits;
    statistics.object_splits = context_->object_splits;
    statistics.median_splits = context_->median_splits;
    statistics.delta_leaves = context_->delta_leaves;
    statistics.delta_leaves_built = context_->delta_leaves_built;
    statistics.delta_leaf_size_histogram = context_->delta_leaf_size_histogram();
    for (size_t i = 0; i < statistics.candidate_wins.size(); ++i) {
      statistics.candidate_wins[i] = context_->candidate_wins[i];
    }
    statistics.peak_build_bytes = context_->peak_bytes();
    const std::optional<TreeShape> shape = state_->final_shape();
    if (shape) statistics.total_seconds = context_->elapsed_seconds();
    if (shape && !statistics.config.lazy) {
      statistics.shape = *shape;
    } else if (const std::shared_ptr<const TreeSnapshot> snapshot = state_->snapshot()) {
      statistics.shape = snapshot->tree->Shape();
    }
    return statistics;
  }

 private:
  const Config config_;
  const int threads_;
  const std::shared_ptr<BuildContext> context_;
  const std::shared_ptr<SharedState> state_;
  std::thread thread_;
};

}  // namespace

std::shared_ptr<Build> Build::Start(std::shared_ptr<const TriangleMesh> mesh, Options options) {
  return std::make_shared<AsynchronousBuild>(std::move(mesh), std::move(options));
}

}  // namespace deltaray
