// Ends a process that does not end by itself.

#ifndef SERVER_SERVICE_EXIT_DEADLINE_H_
#define SERVER_SERVICE_EXIT_DEADLINE_H_

#include <chrono>
#include <thread>

#include "server/build/mutex.h"

namespace deltaray {

// Where it still lives after `time`, the process ends at once, with `exit_code`. All that was acknowledged is on disk,
// and what hangs, as a disk that does not answer may, is not worth waiting for.
class ExitDeadline {
 public:
  ExitDeadline(std::chrono::milliseconds time, int exit_code);
  ~ExitDeadline();

 private:
  Mutex mutex_;
  Condition ended_changed_;
  bool ended_ ABSL_GUARDED_BY(mutex_) = false;
  std::thread thread_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_EXIT_DEADLINE_H_
