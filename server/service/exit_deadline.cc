#include "server/service/exit_deadline.h"

#include <unistd.h>

#include "spdlog/spdlog.h"

namespace deltaray {

ExitDeadline::ExitDeadline(std::chrono::milliseconds time, int exit_code)
    : thread_([this, deadline = std::chrono::steady_clock::now() + time, exit_code] {
        MutexLock lock(mutex_);
        while (!ended_) {
          if (ended_changed_.wait_until(mutex_, deadline) == std::cv_status::timeout && !ended_) {
            spdlog::critical("something hangs; ended without it");
            _exit(exit_code);
          }
        }
      }) {}

ExitDeadline::~ExitDeadline() {
  {
    MutexLock lock(mutex_);
    ended_ = true;
  }
  ended_changed_.notify_all();
  thread_.join();
}

}  // namespace deltaray
