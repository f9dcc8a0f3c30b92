// Gives builds their numbers and their turns.

#ifndef SERVER_STORE_BUILD_QUEUE_H_
#define SERVER_STORE_BUILD_QUEUE_H_

#include <atomic>
#include <cstdint>
#include <deque>
#include <functional>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "server/build/build.h"
#include "server/build/mutex.h"
#include "server/store/mesh_store.h"

namespace deltaray {

// Runs jobs, each a whole build, in the order in which they came; a few at a time, on threads of its own, so that who
// asks for a build never waits for it or for the disk. Thread-safe.
class BuildQueue {
 public:
  // `concurrent_builds`: at least 1. `max_queued`: jobs that wait. `options`: those of each build, but for its config.
  // `on_build_end`: of MeshStore::Options; may be empty.
  BuildQueue(uint32_t concurrent_builds, uint32_t max_queued, Build::Options options,
             std::function<void(const EndedBuild&)> on_build_end = nullptr);
  // As Stop.
  ~BuildQueue();

  // Numbers count from 1 over all meshes of the store, since it was opened.
  uint64_t NextNumber() { return ++last_number_; }
  const Build::Options& options() const { return options_; }
  const std::function<void(const EndedBuild&)>& on_build_end() const { return on_build_end_; }

  // Jobs that wait for their turn, and those that run.
  size_t waiting() const;
  size_t running() const;

  // RESOURCE_EXHAUSTED where too many jobs wait. The job `replaced`, where it has not begun, is dropped for this one. A
  // job that comes after Stop is dropped.
  absl::Status Push(uint64_t number, std::function<void()> job, uint64_t replaced);
  // Whether Push has room. `replaced`: 0 where there is none that waits.
  absl::Status CheckRoom(uint64_t replaced) const;
  // Drops a job that has not begun.
  void Remove(uint64_t number);
  // Drops the jobs that have not begun and waits for the others.
  void Stop();

 private:
  struct Job {
    uint64_t number;
    std::function<void()> run;
  };

  void Work();
  std::deque<Job>::const_iterator Find(uint64_t number) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Takes a job out that has not begun.
  bool Take(uint64_t number, Job* taken) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::Status HasRoom() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const Build::Options options_;
  const std::function<void(const EndedBuild&)> on_build_end_;
  const uint32_t max_queued_;
  std::atomic<uint64_t> last_number_{0};
  mutable Mutex mutex_;
  Condition changed_;
  bool stopped_ ABSL_GUARDED_BY(mutex_) = false;
  std::deque<Job> jobs_ ABSL_GUARDED_BY(mutex_);
  size_t running_ ABSL_GUARDED_BY(mutex_) = 0;
  std::vector<std::thread> threads_;
};

}  // namespace deltaray

#endif  // SERVER_STORE_BUILD_QUEUE_H_
