// Gives builds their numbers and their turns.

#ifndef SERVER_STORE_BUILD_QUEUE_H_
#define SERVER_STORE_BUILD_QUEUE_H_

#include <atomic>
#include <cstdint>
#include <deque>
#include <functional>
#include <thread>
#include <vector>

#include "server/build/build.h"
#include "server/build/mutex.h"
#include "server/store/mesh_store.h"

namespace deltaray {

// Runs jobs, each a whole build, in the order in which they came; a few at a time, on threads of its own, so that who
// asks for a build never waits for it or for the disk. Thread-safe.
class BuildQueue {
 public:
  // `concurrent_builds`: at least 1. `options`: those of each build, but for its config. `on_build_end`: of
  // MeshStore::Options; may be empty.
  BuildQueue(uint32_t concurrent_builds, Build::Options options,
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

  // A job that comes after Stop is dropped.
  void Push(std::function<void()> job);
  // Drops the jobs that have not begun and waits for the others.
  void Stop();

 private:
  void Work();

  const Build::Options options_;
  const std::function<void(const EndedBuild&)> on_build_end_;
  std::atomic<uint64_t> last_number_{0};
  mutable Mutex mutex_;
  Condition changed_;
  bool stopped_ ABSL_GUARDED_BY(mutex_) = false;
  std::deque<std::function<void()>> jobs_ ABSL_GUARDED_BY(mutex_);
  size_t running_ ABSL_GUARDED_BY(mutex_) = 0;
  std::vector<std::thread> threads_;
};

}  // namespace deltaray

#endif  // SERVER_STORE_BUILD_QUEUE_H_
