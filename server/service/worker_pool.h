// Threads for what would block a reaction of gRPC: disk writes, fsync, reading of uploaded files.

#ifndef SERVER_SERVICE_WORKER_POOL_H_
#define SERVER_SERVICE_WORKER_POOL_H_

#include <cstdint>
#include <deque>
#include <functional>
#include <thread>
#include <vector>

#include "server/build/mutex.h"

namespace deltaray {

// A fixed number of threads that run tasks in order of arrival. Thread-safe.
class WorkerPool {
 public:
  // REQUIRES: threads > 0.
  explicit WorkerPool(uint32_t threads);
  // Runs all tasks that are queued, then ends.
  ~WorkerPool();

  // Runs `task` soon. It must not throw.
  void Run(std::function<void()> task);

 private:
  void Work();

  Mutex mutex_;
  Condition changed_;
  std::deque<std::function<void()>> tasks_ ABSL_GUARDED_BY(mutex_);
  bool ending_ ABSL_GUARDED_BY(mutex_) = false;
  std::vector<std::thread> threads_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_WORKER_POOL_H_
