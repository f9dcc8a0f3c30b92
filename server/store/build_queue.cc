#include "server/store/build_queue.h"

#include <algorithm>
#include <utility>

namespace deltaray {

BuildQueue::BuildQueue(uint32_t concurrent_builds, Build::Options options,
                       std::function<void(const EndedBuild&)> on_build_end)
    : options_(std::move(options)), on_build_end_(std::move(on_build_end)) {
  for (uint32_t i = 0; i < std::max(1u, concurrent_builds); ++i) threads_.emplace_back([this] { Work(); });
}

BuildQueue::~BuildQueue() { Stop(); }

void BuildQueue::Push(std::function<void()> job) {
  MutexLock lock(mutex_);
  if (stopped_) return;
  jobs_.push_back(std::move(job));
  changed_.notify_one();
}

void BuildQueue::Stop() {
  std::deque<std::function<void()>> dropped;  // destroyed without the lock
  {
    MutexLock lock(mutex_);
    stopped_ = true;
    dropped.swap(jobs_);
    changed_.notify_all();
  }
  for (std::thread& thread : threads_) {
    if (thread.joinable()) thread.join();
  }
}

size_t BuildQueue::waiting() const {
  MutexLock lock(mutex_);
  return jobs_.size();
}

size_t BuildQueue::running() const {
  MutexLock lock(mutex_);
  return running_;
}

void BuildQueue::Work() {
  for (;;) {
    std::function<void()> job;
    {
      MutexLock lock(mutex_);
      while (jobs_.empty() && !stopped_) changed_.wait(mutex_);
      if (stopped_) return;
      job = std::move(jobs_.front());
      jobs_.pop_front();
      ++running_;
    }
    job();
    MutexLock lock(mutex_);
    --running_;
  }
}

}  // namespace deltaray
