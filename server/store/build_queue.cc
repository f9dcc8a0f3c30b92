#include "server/store/build_queue.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"

namespace deltaray {

BuildQueue::BuildQueue(uint32_t concurrent_builds, uint32_t max_queued, Build::Options options,
                       std::function<void(const EndedBuild&)> on_build_end)
    : options_(std::move(options)), on_build_end_(std::move(on_build_end)), max_queued_(max_queued) {
  for (uint32_t i = 0; i < std::max(1u, concurrent_builds); ++i) threads_.emplace_back([this] { Work(); });
}

BuildQueue::~BuildQueue() { Stop(); }

absl::Status BuildQueue::Push(uint64_t number, std::function<void()> job, uint64_t replaced) {
  Job dropped;  // destroyed without the lock
  MutexLock lock(mutex_);
  if (stopped_) return absl::OkStatus();
  if (Take(replaced, &dropped) || HasRoom().ok()) {
    jobs_.push_back({number, std::move(job)});
    changed_.notify_one();
    return absl::OkStatus();
  }
  return HasRoom();
}

absl::Status BuildQueue::CheckRoom(uint64_t replaced) const {
  MutexLock lock(mutex_);
  return replaced != 0 && Find(replaced) != jobs_.end() ? absl::OkStatus() : HasRoom();
}

absl::Status BuildQueue::HasRoom() const {
  if (jobs_.size() < max_queued_) return absl::OkStatus();
  return absl::ResourceExhaustedError(
      absl::StrCat("the limit of ", max_queued_, " builds that wait is met (--max-queued-builds); retry"));
}

void BuildQueue::Remove(uint64_t number) {
  Job dropped;  // destroyed without the lock
  MutexLock lock(mutex_);
  Take(number, &dropped);
}

std::deque<BuildQueue::Job>::const_iterator BuildQueue::Find(uint64_t number) const {
  return std::find_if(jobs_.begin(), jobs_.end(), [&](const Job& job) { return job.number == number; });
}

bool BuildQueue::Take(uint64_t number, Job* taken) {
  const auto job = Find(number);
  if (job == jobs_.end()) return false;
  *taken = *job;
  jobs_.erase(job);
  return true;
}

void BuildQueue::Stop() {
  std::deque<Job> dropped;  // destroyed without the lock
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
    Job job;
    {
      MutexLock lock(mutex_);
      while (jobs_.empty() && !stopped_) changed_.wait(mutex_);
      if (stopped_) return;
      job = std::move(jobs_.front());
      jobs_.pop_front();
      ++running_;
    }
    job.run();
    MutexLock lock(mutex_);
    --running_;
  }
}

}  // namespace deltaray
