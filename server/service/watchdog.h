// Notices that the server does not work any more, from within.

#ifndef SERVER_SERVICE_WATCHDOG_H_
#define SERVER_SERVICE_WATCHDOG_H_

#include <chrono>
#include <functional>
#include <string>
#include <thread>

#include "server/build/mutex.h"

namespace deltaray {

// Looks every so often, on a thread of its own, until it is destroyed.
class Watchdog {
 public:
  // `probe` tells what is wrong; empty: nothing. `on_failure` is called after each probe that told something, which is
  // also logged. Both may block for a while, which the destructor waits for.
  Watchdog(std::chrono::milliseconds interval, std::function<std::string()> probe, std::function<void()> on_failure);
  ~Watchdog();

 private:
  void Run();

  const std::chrono::milliseconds interval_;
  const std::function<std::string()> probe_;
  const std::function<void()> on_failure_;
  Mutex mutex_;
  Condition stop_;
  bool stopped_ ABSL_GUARDED_BY(mutex_) = false;
  std::thread thread_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_WATCHDOG_H_
