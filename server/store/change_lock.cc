#include "server/store/change_lock.h"

#include "absl/strings/str_cat.h"

namespace deltaray {

absl::StatusOr<ChangeLock::Held> ChangeLock::Take() {
  using Clock = std::chrono::steady_clock;
  const Clock::time_point begin = Clock::now();
  Clock::time_point deadline;
  {
    MutexLock lock(mutex_);
    deadline = begin + (stuck_ ? timeout_ / 100 : timeout_);
    while (taken_ && Clock::now() < deadline) given_back_.wait_until(mutex_, deadline);
    if (taken_) {
      return absl::UnavailableError("changes before this one still wait for the lock of the data directory");
    }
    taken_ = true;
  }
  Held held(this);
  absl::StatusOr<FileDescriptor> file =
      directory_->Lock(std::chrono::duration_cast<std::chrono::milliseconds>(deadline - Clock::now()));
  {
    MutexLock lock(mutex_);
    stuck_ = absl::IsUnavailable(file.status());
  }
  if (!file.ok()) return file.status();
  held.file_ = *std::move(file);
  return held;
}

void ChangeLock::GiveBack() {
  MutexLock lock(mutex_);
  taken_ = false;
  given_back_.notify_one();
}

}  // namespace deltaray
