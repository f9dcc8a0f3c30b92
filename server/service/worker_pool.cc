#include "server/service/worker_pool.h"

#include <iterator>
#include <utility>

namespace deltaray {

WorkerPool::WorkerPool(uint32_t threads) {
  for (uint32_t i = 0; i < threads; ++i) threads_.emplace_back([this] { Work(); });
}

WorkerPool::~WorkerPool() {
  {
    MutexLock lock(mutex_);
    ending_ = true;
  }
  changed_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

void WorkerPool::Run(std::function<void()> task, std::function<bool()> cancelled) {
  {
    MutexLock lock(mutex_);
    tasks_.push_back({std::move(task), std::move(cancelled)});
  }
  changed_.notify_one();
}

void WorkerPool::ForgetCancelled() {
  std::list<Task> forgotten;  // gone without the lock
  MutexLock lock(mutex_);
  for (auto task = tasks_.begin(); task != tasks_.end();) {
    const auto next = std::next(task);
    if (task->is_cancelled()) forgotten.splice(forgotten.end(), tasks_, task);
    task = next;
  }
}

void WorkerPool::Work() {
  for (;;) {
    Task task;
    {
      MutexLock lock(mutex_);
      while (tasks_.empty() && !ending_) changed_.wait(mutex_);
      if (tasks_.empty()) return;
      task = std::move(tasks_.front());
      tasks_.pop_front();
    }
    if (!task.is_cancelled()) task.run();
  }
}

}  // namespace deltaray
