// A build that is held up at its δ-leaves, so that tests of what is answered meanwhile are certain.

#ifndef TESTS_PROPERTY_GATED_BUILD_H_
#define TESTS_PROPERTY_GATED_BUILD_H_

#include <chrono>
#include <cstdint>
#include <memory>
#include <thread>
#include <utility>

#include "server/build/build.h"
#include "server/build/mutex.h"

namespace deltaray {

// Lets so many δ-leaves be built, and holds up the tasks of others.
class Turnstile {
 public:
  void Let(uint64_t leaves) {
    {
      MutexLock lock(mutex_);
      let_ += leaves;
    }
    changed_.notify_all();
  }
  void Pass() {
    MutexLock lock(mutex_);
    while (let_ == 0) changed_.wait(mutex_);
    --let_;
  }

 private:
  Mutex mutex_;
  Condition changed_;
  uint64_t let_ ABSL_GUARDED_BY(mutex_) = 0;
};

inline constexpr uint64_t kAllLeaves = uint64_t{1} << 40;

// Lets all pass however the test ends, before the build is destroyed, which waits for its tasks.
struct GatedBuild {
  GatedBuild(std::shared_ptr<const TriangleMesh> mesh, const Config& config, uint32_t threads)
      : build(Build::Start(std::move(mesh), {config, threads, [turnstile = turnstile] { turnstile->Pass(); }})) {}
  ~GatedBuild() { turnstile->Let(kAllLeaves); }

  // Returns once `leaves` more are built, and no other.
  void Advance(uint64_t leaves) {
    const uint64_t wanted = build->progress().delta_leaves_built + leaves;
    turnstile->Let(leaves);
    while (build->progress().delta_leaves_built < wanted) std::this_thread::sleep_for(std::chrono::microseconds(100));
  }

  std::shared_ptr<Turnstile> turnstile = std::make_shared<Turnstile>();
  std::shared_ptr<Build> build;
};

}  // namespace deltaray

#endif  // TESTS_PROPERTY_GATED_BUILD_H_
