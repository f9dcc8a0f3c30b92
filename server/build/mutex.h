// std::mutex with the annotations of clang's thread safety analysis.
//
// absl::Mutex would serve, but Debian's is built without thread sanitizer hooks, so that the sanitizer sees a race
// behind every lock; pthread's locks it knows.

#ifndef SERVER_BUILD_MUTEX_H_
#define SERVER_BUILD_MUTEX_H_

#include <condition_variable>
#include <mutex>

#include "absl/base/thread_annotations.h"

namespace deltaray {

class ABSL_LOCKABLE Mutex {
 public:
  void lock() ABSL_EXCLUSIVE_LOCK_FUNCTION() { mutex_.lock(); }
  void unlock() ABSL_UNLOCK_FUNCTION() { mutex_.unlock(); }

 private:
  std::mutex mutex_;
};

class ABSL_SCOPED_LOCKABLE MutexLock {
 public:
  explicit MutexLock(Mutex& mutex) ABSL_EXCLUSIVE_LOCK_FUNCTION(mutex) : mutex_(mutex) { mutex_.lock(); }
  ~MutexLock() ABSL_UNLOCK_FUNCTION() { mutex_.unlock(); }
  MutexLock(const MutexLock&) = delete;
  MutexLock& operator=(const MutexLock&) = delete;

 private:
  Mutex& mutex_;
};

// Wait on it with a Mutex: condition.wait(mutex).
using Condition = std::condition_variable_any;

}  // namespace deltaray

#endif  // SERVER_BUILD_MUTEX_H_
