// One build of one mesh, from the queue to its end.

#ifndef SERVER_STORE_BUILD_RUN_H_
#define SERVER_STORE_BUILD_RUN_H_

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/build/build.h"
#include "server/build/mutex.h"
#include "server/store/mesh_store.h"
#include "server/store/tree_budget.h"

namespace deltaray {

// When the first ray was answered from a build. Thread-safe.
class FirstAnswer {
 public:
  void Begin() { begin_ = Now(); }
  // One relaxed read for all but the first.
  void Note() {
    int64_t none = 0;
    if (at_.load(std::memory_order_relaxed) == none) at_.compare_exchange_strong(none, Now());
  }
  // From Begin to the first Note; 0: none yet.
  double seconds() const {
    const int64_t at = at_;
    return at == 0 ? 0 : 1e-9 * static_cast<double>(at - begin_);
  }

 private:
  static int64_t Now() { return std::chrono::steady_clock::now().time_since_epoch() / std::chrono::nanoseconds(1); }

  std::atomic<int64_t> begin_{0};  // nanoseconds of the steady clock
  std::atomic<int64_t> at_{0};     // 0: no answer yet
};

// The seconds of a build count from the end of its wait in the queue, and those to load the mesh from disk count as
// part of BuildPhase::kReferences. Thread-safe.
class BuildRun {
 public:
  // Gives the mesh to build; asks now and then whether it was cancelled.
  using LoadMesh =
      std::function<absl::StatusOr<std::shared_ptr<const TriangleMesh>>(const std::function<bool()>& cancelled)>;

  BuildRun(uint64_t number, const Config& config, uint64_t triangles)
      : number_(number), config_(config), triangles_(triangles) {}

  // Builds with `options` but the run's own config, and blocks until the build has ended. Calls `on_provisional` once
  // rays can be answered; it is over before has_ended(). REQUIRES: called at most once.
  absl::Status Run(const LoadMesh& load, const Build::Options& options, const std::function<void()>& on_provisional);

  // A run that has ended in the same way and has no tree. REQUIRES: has_ended().
  std::shared_ptr<BuildRun> WithoutTree() const;

  // Makes Run end soon, also where it comes before Run.
  void Cancel();
  // Gives the run the memory that it may take until its tree stands. From then on it has as much as the tree and its
  // mesh take, until it and all who hold snapshot() are gone.
  void Hold(std::shared_ptr<TreeBudget::Reservation> memory);

  uint64_t number() const { return number_; }
  const Config& config() const { return config_; }
  const std::shared_ptr<FirstAnswer>& first_answer() const { return first_answer_; }

  bool has_ended() const;
  // OK until Run has ended otherwise.
  absl::Status status() const;
  // The best tree so far, with its memory; null: none.
  std::shared_ptr<const TreeSnapshot> snapshot() const;
  // What was given to Hold, as far as the run still has it; null: none.
  std::shared_ptr<TreeBudget::Reservation> memory() const;
  // Never kStored.
  BuildReport Report() const;
  // Of the tree that stood when the build ended; 0 before.
  uint64_t tree_bytes() const { return tree_bytes_; }
  // The build as it ended. REQUIRES: has_ended().
  EndedBuild Ended(const std::string& mesh_id) const;
  // REQUIRES: snapshot() was not null.
  StoredStatistics Statistics() const;

 private:
  absl::Status LoadAndBuild(const LoadMesh& load, Build::Options options, const std::function<void()>& on_provisional);
  std::shared_ptr<Build> build() const;
  // Gives back what the build took beside the tree that stands, and its provisional one before.
  void HoldTree(uint64_t provisional_bytes);

  const uint64_t number_;
  const Config config_;
  const uint64_t triangles_;  // of the mesh
  const std::shared_ptr<FirstAnswer> first_answer_ = std::make_shared<FirstAnswer>();
  std::atomic<bool> cancelled_{false};
  std::atomic<uint64_t> tree_bytes_{0};

  mutable Mutex mutex_;
  bool begun_ ABSL_GUARDED_BY(mutex_) = false;
  std::chrono::steady_clock::time_point begin_ ABSL_GUARDED_BY(mutex_);
  PhaseTime load_ ABSL_GUARDED_BY(mutex_);
  std::shared_ptr<Build> build_ ABSL_GUARDED_BY(mutex_);
  std::shared_ptr<TreeBudget::Reservation> memory_ ABSL_GUARDED_BY(mutex_);
  bool ended_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Status status_ ABSL_GUARDED_BY(mutex_);
  BuildProgress last_progress_ ABSL_GUARDED_BY(mutex_);  // once it has ended
};

}  // namespace deltaray

#endif  // SERVER_STORE_BUILD_RUN_H_
