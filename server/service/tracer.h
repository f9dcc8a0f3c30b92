// The threads that trace rays.

#ifndef SERVER_SERVICE_TRACER_H_
#define SERVER_SERVICE_TRACER_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>

#include "oneapi/tbb/global_control.h"
#include "oneapi/tbb/task_arena.h"
#include "server/build/mutex.h"

namespace deltaray {

// A TBB arena of its own, of higher priority than the arenas of builds. Thread-safe.
class Tracer {
 public:
  // threads = 0: all cores.
  explicit Tracer(uint32_t threads);
  // Waits for all tasks.
  ~Tracer();

  // Runs `task` soon on a thread of the arena. It must not throw. After Stop nothing is run, and `task` is dropped.
  // Throws std::bad_alloc: whether it will be run is open then.
  void Enqueue(std::function<void()> task);

  // The same for a task that takes a few milliseconds at most: it need not wait for those that take long.
  void EnqueueShort(std::function<void()> task);
  // To be called by tasks that take long, now and then and without locks: runs a short task, where one waits. A thread
  // that runs a short task already runs none.
  void RunShort();

  // Runs the tasks that are queued, waits for their end, and takes no more.
  void Stop();

  // Calls body(first, last) for pieces of [0, size), each `piece` long but the last one, and returns once all are done.
  // On a thread of the arena the pieces are spread over its threads. Body must not throw.
  static void ForPieces(size_t size, size_t piece, const std::function<void(size_t first, size_t last)>& body);

  // Threads that ForPieces spreads over, on the calling thread.
  static size_t Concurrency();

  uint32_t threads() const { return threads_; }

 private:
  // Has TBB make its threads now: one that cannot be made later, because the system has none left, is lost to it for
  // good.
  void StartWorkers();
  template <typename Task>
  void Submit(Task task);
  // One task less.
  void NoteEnd();

  const uint32_t threads_;
  // TBB makes one worker less than there are cores, for it counts on the calling thread to help; ours never does.
  const tbb::global_control workers_;
  tbb::task_arena arena_;
  Mutex mutex_;
  Condition idle_;
  size_t tasks_ ABSL_GUARDED_BY(mutex_) = 0;
  bool stopped_ ABSL_GUARDED_BY(mutex_) = false;
  std::deque<std::function<void()>> short_tasks_ ABSL_GUARDED_BY(mutex_);
  std::atomic<size_t> short_task_count_{0};  // of short_tasks_, for a look without the lock
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_TRACER_H_
