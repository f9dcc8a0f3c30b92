#include "server/store/change_lock.h"

#include "absl/strings/str_cat.h"

namespace deltaray {

absl::StatusOr<ChangeLock::Held> ChangeLock::Take() {
  using Clock = std::chrono::steady_clock;
  const Clock::time_point begin = Clock::now();
  std::chrono::milliseconds timeout;
  const auto in_vain = [&](absl::string_view why) {
    return absl::UnavailableError(absl::StrCat(why, "; waited for ", timeout.count(), " ms"));
  };
  {
    MutexLock lock(mutex_);
    timeout = begin < stuck_until_ ? timeout_ / 100 : timeout_;
    while (taken_ && Clock::now() < begin + timeout) given_back_.wait_until(mutex_, begin + timeout);
    if (taken_) return in_vain("changes before this one still wait for the lock of the data directory");
    taken_ = true;
  }
  Held held(this);
  const Clock::time_point file_begin = Clock::now();
  absl::StatusOr<FileDescriptor> file =
      directory_->Lock(std::chrono::ceil<std::chrono::milliseconds>(begin + timeout - file_begin));
  {
    MutexLock lock(mutex_);
    const Clock::time_point now = Clock::now();
    if (!absl::IsUnavailable(file.status())) {
      stuck_until_ = {};
    } else if (now - file_begin >= timeout_ - timeout_ / 100) {
      // For shorter than that, the lock may have been free, and in use, all the time before.
      stuck_until_ = now + timeout_;
    }
  }
  if (absl::IsUnavailable(file.status())) return in_vain(file.status().message());
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
