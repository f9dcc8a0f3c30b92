#include "server/service/calls.h"

#include <vector>

namespace deltaray {

absl::Status DrainingError() { return absl::UnavailableError("the server is draining"); }

bool Calls::Add(const std::shared_ptr<Call>& call) {
  MutexLock lock(mutex_);
  if (draining_) return false;
  calls_.emplace(call.get(), call);
  return true;
}

void Calls::Remove(const Call* call) {
  {
    MutexLock lock(mutex_);
    calls_.erase(call);
  }
  changed_.notify_all();
}

void Calls::Drain() {
  std::vector<std::shared_ptr<Call>> calls;
  {
    MutexLock lock(mutex_);
    draining_ = true;
    for (const auto& [key, call] : calls_) {
      if (auto alive = call.lock()) calls.push_back(std::move(alive));
    }
  }
  for (const auto& call : calls) call->OnDrain();
}

bool Calls::WaitUntilNone(std::chrono::steady_clock::time_point deadline) {
  MutexLock lock(mutex_);
  while (!calls_.empty()) {
    if (changed_.wait_until(mutex_, deadline) == std::cv_status::timeout) return calls_.empty();
  }
  return true;
}

}  // namespace deltaray
