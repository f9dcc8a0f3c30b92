#include "server/service/calls.h"

#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/time.h"

namespace deltaray {

absl::Status DrainingError() { return absl::UnavailableError("the server is draining"); }

absl::Status CutOffError() { return absl::UnavailableError("cut off at the end of the server's drain"); }

absl::Status Calls::Add(const std::shared_ptr<Call>& call, RpcInfo rpc) {
  rpc.record = &call->record();
  absl::Status status;
  size_t watched = 0;
  while (status.ok() && watched < watchers_.size()) status = watchers_[watched++]->OnBegin(rpc);
  MutexLock lock(mutex_);
  // Noted even where it is refused: it is under way until gRPC is done with it.
  calls_.emplace(call.get(), UnderWay{call, rpc, watched});
  return status.ok() && draining_ ? DrainingError() : status;
}

void Calls::NoteAnswer(const Call* call) {
  UnderWay answered;
  {
    MutexLock lock(mutex_);
    answered = calls_.find(call)->second;
  }
  while (answered.watched > 0) watchers_[--answered.watched]->OnAnswer(answered.rpc);
}

void Calls::Remove(const Call* call, const absl::Status& status) {
  UnderWay ended;
  {
    MutexLock lock(mutex_);
    const auto it = calls_.find(call);
    ended = std::move(it->second);
  }
  while (ended.watched > 0) watchers_[--ended.watched]->OnEnd(ended.rpc, status);
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
    calls = Alive();
  }
  for (const auto& call : calls) call->OnDrain();
}

void Calls::Tick(std::chrono::steady_clock::time_point now) {
  std::vector<std::shared_ptr<Call>> calls;
  {
    MutexLock lock(mutex_);
    calls = Alive();
  }
  for (const auto& call : calls) call->OnTick(now - idle_timeout_);
}

std::vector<std::shared_ptr<Call>> Calls::Alive() const {
  std::vector<std::shared_ptr<Call>> calls;
  for (const auto& [key, under_way] : calls_) {
    if (auto alive = under_way.call.lock()) calls.push_back(std::move(alive));
  }
  return calls;
}

absl::Status Calls::IdleError(absl::string_view what) const {
  return absl::DeadlineExceededError(absl::StrCat(
      "the client has ", what, " for ", absl::FormatDuration(absl::FromChrono(idle_timeout_)), " (--idle-timeout)"));
}

bool Calls::WaitUntilNone(std::chrono::steady_clock::time_point deadline) {
  MutexLock lock(mutex_);
  while (!calls_.empty()) {
    if (changed_.wait_until(mutex_, deadline) == std::cv_status::timeout) {
      cut_off_.store(!calls_.empty(), std::memory_order_relaxed);
      return calls_.empty();
    }
  }
  return true;
}

}  // namespace deltaray
