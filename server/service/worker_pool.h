// Threads for what would block a reaction of gRPC: disk writes, fsync, reading of uploaded files.

#ifndef SERVER_SERVICE_WORKER_POOL_H_
#define SERVER_SERVICE_WORKER_POOL_H_

#include <cstdint>
#include <functional>
#include <list>
#include <thread>
#include <vector>

#include "server/build/mutex.h"

namespace deltaray {

// A fixed number of threads that run tasks in order of arrival. Thread-safe.
class WorkerPool {
 public:
  // REQUIRES: threads > 0.
  explicit WorkerPool(uint32_t threads);
  // Runs all tasks that are queued and not cancelled, then ends.
  ~WorkerPool();

  // Runs `task` soon. It must not throw. Where `cancelled`, asked from any thread, says that nobody wants it any more,
  // it is not begun.
  void Run(std::function<void()> task, std::function<bool()> cancelled = nullptr);

  // Lets go of the tasks that nobody wants any more, and of what they hold. To be called several times a second.
  void ForgetCancelled();

 private:
  struct Task {
    std::function<void()> run;
    std::function<bool()> cancelled;
    bool is_cancelled() const { return cancelled != nullptr && cancelled(); }
  };

  void Work();

  Mutex mutex_;
  Condition changed_;
  std::list<Task> tasks_ ABSL_GUARDED_BY(mutex_);
  bool ending_ ABSL_GUARDED_BY(mutex_) = false;
  std::vector<std::thread> threads_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_WORKER_POOL_H_
