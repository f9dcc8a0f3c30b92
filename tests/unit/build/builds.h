// Builds that tests start, and hold up.

#ifndef TESTS_UNIT_BUILD_BUILDS_H_
#define TESTS_UNIT_BUILD_BUILDS_H_

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <thread>
#include <utility>

#include "gtest/gtest.h"
#include "server/build/build.h"

namespace deltaray {

inline std::shared_ptr<const TriangleMesh> Shared(TriangleMesh mesh) {
  return std::make_shared<const TriangleMesh>(std::move(mesh));
}

inline std::shared_ptr<Build> Start(const std::shared_ptr<const TriangleMesh>& mesh, const Config& config,
                                    uint32_t threads = 2, std::function<void()> on_delta_leaf = nullptr) {
  EXPECT_TRUE(Validate(config).ok());
  return Build::Start(mesh, {.config = config, .threads = threads, .on_delta_leaf = std::move(on_delta_leaf)});
}

// Lets δ-leaves through one by one once opened; until then the build stands still.
class Gate {
 public:
  void Open() { open_ = true; }
  std::function<void()> Pass() {
    return [this] {
      ++waiting_;
      while (!open_) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    };
  }
  int waiting() const { return waiting_; }

 private:
  std::atomic<bool> open_{false};
  std::atomic<int> waiting_{0};
};

}  // namespace deltaray

#endif  // TESTS_UNIT_BUILD_BUILDS_H_
