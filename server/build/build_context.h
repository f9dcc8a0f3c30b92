// What all tasks of one build share: whether to go on, what they count, and the clock.

#ifndef SERVER_BUILD_BUILD_CONTEXT_H_
#define SERVER_BUILD_BUILD_CONTEXT_H_

#include <array>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "server/build/config.h"
#include "server/build/mutex.h"
#include "server/build/statistics.h"

namespace deltaray {

// A node of the top with fewer references is built by one task, with all below it.
inline constexpr size_t kTaskReferences = 4096;

// Thread-safe. Counters may be added to by any task, where the counted thing happens.
class BuildContext {
 public:
  BuildContext();

  // Long work polls cancelled() at least every few milliseconds and returns early, with anything, once it is true; who
  // started the work checks it before using what it gave.
  void Cancel() { cancelled_.store(true, std::memory_order_relaxed); }
  bool cancelled() const { return cancelled_.load(std::memory_order_relaxed); }

  std::atomic<uint64_t> triangles{0};
  std::atomic<uint64_t> references_placed{0};
  std::atomic<uint64_t> spatial_splits{0};
  std::atomic<uint64_t> object_splits{0};
  std::atomic<uint64_t> median_splits{0};
  std::atomic<uint64_t> delta_leaves{0};
  std::atomic<uint64_t> delta_leaves_built{0};
  std::array<std::atomic<uint64_t>, 4> candidate_wins{};  // by DeltaLeafCandidate

  // Counts a δ-leaf of the top, as its size is known. REQUIRES: references > 0.
  void CountDeltaLeaf(uint32_t references);
  std::vector<uint64_t> delta_leaf_size_histogram() const;

  // What Preset::kAuto chose: the config that the build goes by, and why. Nothing before, and for other presets.
  void SetChoice(const Config& config, std::vector<std::string> reasons);
  std::optional<Config> chosen_config() const;
  std::vector<std::string> choices() const;

  // Bytes of references that the build holds, without the trees over them. The most of them at any time is kept.
  void CountBytes(int64_t added);
  uint64_t peak_bytes() const { return peak_bytes_.load(std::memory_order_relaxed); }

  // Ends the running phase and starts `phase`. Called by the one thread that leads the build.
  void EnterPhase(BuildPhase phase);
  BuildPhase phase() const { return phase_.load(std::memory_order_relaxed); }
  // The phases entered so far, but for kQueued and kDone.
  std::vector<PhaseTime> phases() const;
  // Since the context was made; stops at kDone.
  double elapsed_seconds() const;

  // Adds the processor time of this thread, from construction to destruction, to a phase. Every task holds one while it
  // works. Where a thread that holds one starts another (a task run while it waits), only the outer one counts.
  class CpuTime {
   public:
    explicit CpuTime(BuildContext& context) : CpuTime(context, context.phase()) {}
    CpuTime(BuildContext& context, BuildPhase phase);
    ~CpuTime();
    CpuTime(const CpuTime&) = delete;
    CpuTime& operator=(const CpuTime&) = delete;

   private:
    std::atomic<int64_t>* nanoseconds_ = nullptr;  // null: an inner one
    int64_t start_ = 0;
  };

 private:
  using Clock = std::chrono::steady_clock;
  static constexpr size_t kPhases = static_cast<size_t>(BuildPhase::kDone) + 1;

  std::atomic<bool> cancelled_{false};
  std::array<std::atomic<uint64_t>, 32> delta_leaf_sizes_{};
  std::atomic<int64_t> bytes_{0};
  std::atomic<uint64_t> peak_bytes_{0};

  const Clock::time_point start_;
  std::atomic<BuildPhase> phase_{BuildPhase::kQueued};
  std::array<std::atomic<int64_t>, kPhases> cpu_nanoseconds_{};
  mutable Mutex mutex_;
  std::array<Clock::time_point, kPhases> entered_ ABSL_GUARDED_BY(mutex_){};
  std::array<Clock::time_point, kPhases> left_ ABSL_GUARDED_BY(mutex_){};
  std::optional<Config> chosen_config_ ABSL_GUARDED_BY(mutex_);
  std::vector<std::string> choices_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace deltaray

#endif  // SERVER_BUILD_BUILD_CONTEXT_H_
