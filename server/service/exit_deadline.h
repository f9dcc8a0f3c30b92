// Ends a process that does not end by itself.

#ifndef SERVER_SERVICE_EXIT_DEADLINE_H_
#define SERVER_SERVICE_EXIT_DEADLINE_H_

#include <chrono>
#include <optional>
#include <thread>

#include "server/build/mutex.h"

namespace deltaray {

// Where it still lives `time` after Begin(time), the process ends at once, with `exit_code`. All that was acknowledged
// is on disk, and what hangs, as a disk that does not answer may, is not worth waiting for.
//
// To be made when the process starts: when it is to end, there may be no thread to be had.
class ExitDeadline {
 public:
  explicit ExitDeadline(int exit_code);
  ~ExitDeadline();

  // Called at most once.
  void Begin(std::chrono::milliseconds time);

 private:
  Mutex mutex_;
  Condition changed_;
  std::optional<std::chrono::steady_clock::time_point> deadline_ ABSL_GUARDED_BY(mutex_);
  bool ended_ ABSL_GUARDED_BY(mutex_) = false;
  std::thread thread_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_EXIT_DEADLINE_H_
