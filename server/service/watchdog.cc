#include "server/service/watchdog.h"

#include <utility>

#include "spdlog/spdlog.h"

namespace deltaray {

Watchdog::Watchdog(std::chrono::milliseconds interval, std::function<std::string()> probe,
                   std::function<void()> on_failure)
    : interval_(interval), probe_(std::move(probe)), on_failure_(std::move(on_failure)), thread_([this] { Run(); }) {}

Watchdog::~Watchdog() {
  {
    MutexLock lock(mutex_);
    stopped_ = true;
  }
  stop_.notify_all();
  thread_.join();
}

void Watchdog::Run() {
  bool well = true;
  while (true) {
    {
      MutexLock lock(mutex_);
      const auto next = std::chrono::steady_clock::now() + interval_;
      while (!stopped_ && stop_.wait_until(mutex_, next) != std::cv_status::timeout) {
      }
      if (stopped_) return;
    }
    const std::string failure = probe_();
    if (!failure.empty()) {
      spdlog::error("watchdog: {}", failure);
      on_failure_();
    } else if (!well) {
      spdlog::info("watchdog: all is well again");
    }
    well = failure.empty();
  }
}

}  // namespace deltaray
