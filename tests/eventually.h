// Waits for what happens elsewhere, in another thread or process.

#ifndef TESTS_EVENTUALLY_H_
#define TESTS_EVENTUALLY_H_

#include <chrono>
#include <functional>
#include <thread>

namespace deltaray {

// Whether `condition` holds within `limit`: it is asked every few milliseconds until it does.
inline bool Eventually(const std::function<bool()>& condition,
                       std::chrono::milliseconds limit = std::chrono::seconds(10)) {
  const auto deadline = std::chrono::steady_clock::now() + limit;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > deadline) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return true;
}

}  // namespace deltaray

#endif  // TESTS_EVENTUALLY_H_
