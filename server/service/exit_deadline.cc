#include "server/service/exit_deadline.h"

#include <unistd.h>

#include "spdlog/spdlog.h"

namespace deltaray {

ExitDeadline::ExitDeadline(int exit_code)
    : thread_([this, exit_code] {
        MutexLock lock(mutex_);
        while (!ended_ && !deadline_.has_value()) changed_.wait(mutex_);
        while (!ended_) {
          if (changed_.wait_until(mutex_, *deadline_) == std::cv_status::timeout && !ended_) {
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
  changed_.notify_all();
  thread_.join();
}

void ExitDeadline::Begin(std::chrono::milliseconds time) {
  {
    MutexLock lock(mutex_);
    deadline_ = std::chrono::steady_clock::now() + time;
  }
  changed_.notify_all();
}

}  // namespace deltaray
