// The right to change the directory.

#ifndef SERVER_STORE_CHANGE_LOCK_H_
#define SERVER_STORE_CHANGE_LOCK_H_

#include <chrono>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/build/mutex.h"
#include "server/store/data_directory.h"
#include "server/store/durable_file.h"

namespace deltaray {

// Held by one thread of one server at a time. Thread-safe.
class ChangeLock {
 public:
  // Until it is destroyed.
  class Held {
   public:
    explicit Held(ChangeLock* lock) : lock_(lock) {}
    Held(Held&& other) noexcept : lock_(std::exchange(other.lock_, nullptr)), file_(std::move(other.file_)) {}
    Held& operator=(Held&&) = delete;
    ~Held() {
      file_ = FileDescriptor();
      if (lock_ != nullptr) lock_->GiveBack();
    }

   private:
    friend class ChangeLock;
    ChangeLock* lock_;     // against other threads of this server
    FileDescriptor file_;  // against other servers
  };

  // `directory` outlives this. `timeout`: how long a change waits for those of others.
  ChangeLock(const DataDirectory* directory, std::chrono::milliseconds timeout)
      : directory_(directory), timeout_(timeout) {}

  // UNAVAILABLE where others have it for longer than the timeout. Where it was another server for all that time, the
  // wait is a hundredth of it from then on, until somebody gets the lock, or the timeout has passed again: so changes
  // that come meanwhile do not hold all threads.
  absl::StatusOr<Held> Take();

 private:
  void GiveBack();

  const DataDirectory* const directory_;
  const std::chrono::milliseconds timeout_;
  Mutex mutex_;
  Condition given_back_;
  bool taken_ ABSL_GUARDED_BY(mutex_) = false;
  std::chrono::steady_clock::time_point stuck_until_ ABSL_GUARDED_BY(mutex_);  // until when the wait is short
};

}  // namespace deltaray

#endif  // SERVER_STORE_CHANGE_LOCK_H_
