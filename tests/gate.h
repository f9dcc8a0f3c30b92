// Stops builds, for tests.

#ifndef TESTS_GATE_H_
#define TESTS_GATE_H_

#include "server/build/mutex.h"

namespace deltaray {

// Holds back whoever passes while it is closed. It is open at first.
class Gate {
 public:
  void Close() {
    MutexLock lock(mutex_);
    open_ = false;
  }
  void Open() {
    MutexLock lock(mutex_);
    open_ = true;
    changed_.notify_all();
  }
  void Pass() {
    MutexLock lock(mutex_);
    while (!open_) changed_.wait(mutex_);
  }

 private:
  Mutex mutex_;
  Condition changed_;
  bool open_ ABSL_GUARDED_BY(mutex_) = true;
};

}  // namespace deltaray

#endif  // TESTS_GATE_H_
