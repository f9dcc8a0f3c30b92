#include "server/build/build_context.h"

#include <algorithm>
#include <bit>
#include <utility>

#include "server/build/thread_cpu.h"

namespace deltaray {
namespace {

thread_local bool thread_time_is_counted = false;

double Seconds(std::chrono::steady_clock::duration duration) { return std::chrono::duration<double>(duration).count(); }

}  // namespace

BuildContext::BuildContext() : start_(Clock::now()) { entered_[0] = start_; }

void BuildContext::CountDeltaLeaf(uint32_t references) {
  delta_leaves.fetch_add(1, std::memory_order_relaxed);
  delta_leaf_sizes_[std::bit_width(references) - 1].fetch_add(1, std::memory_order_relaxed);
}

std::vector<uint64_t> BuildContext::delta_leaf_size_histogram() const {
  std::vector<uint64_t> histogram(delta_leaf_sizes_.begin(), delta_leaf_sizes_.end());
  while (!histogram.empty() && histogram.back() == 0) histogram.pop_back();
  return histogram;
}

void BuildContext::SetChoice(const Config& config, std::vector<std::string> reasons) {
  MutexLock lock(mutex_);
  chosen_config_ = config;
  choices_ = std::move(reasons);
}

std::optional<Config> BuildContext::chosen_config() const {
  MutexLock lock(mutex_);
  return chosen_config_;
}

std::vector<std::string> BuildContext::choices() const {
  MutexLock lock(mutex_);
  return choices_;
}

void BuildContext::CountBytes(int64_t added) {
  const uint64_t bytes = static_cast<uint64_t>(bytes_.fetch_add(added, std::memory_order_relaxed) + added);
  uint64_t peak = peak_bytes();
  while (bytes > peak && added > 0 && !peak_bytes_.compare_exchange_weak(peak, bytes, std::memory_order_relaxed)) {
  }
}

void BuildContext::EnterPhase(BuildPhase phase) {
  MutexLock lock(mutex_);
  // Read under the lock: nobody was told of a later time in the phase that ends.
  const Clock::time_point now = Clock::now();
  left_[static_cast<size_t>(phase_.load(std::memory_order_relaxed))] = now;
  entered_[static_cast<size_t>(phase)] = now;
  phase_.store(phase, std::memory_order_relaxed);
}

std::vector<PhaseTime> BuildContext::phases() const {
  MutexLock lock(mutex_);
  std::vector<PhaseTime> phases;
  for (size_t i = 1; i + 1 < kPhases; ++i) {
    const double cpu_seconds = 1e-9 * static_cast<double>(cpu_nanoseconds_[i].load(std::memory_order_relaxed));
    const bool entered = entered_[i] != Clock::time_point();
    // A lazy build works on δ-leaves without ever entering that phase.
    if (!entered && cpu_seconds == 0) continue;
    const bool running = entered && left_[i] == Clock::time_point();
    const double wall_seconds = entered ? Seconds((running ? Clock::now() : left_[i]) - entered_[i]) : 0;
    phases.push_back({static_cast<BuildPhase>(i), wall_seconds, cpu_seconds});
  }
  return phases;
}

double BuildContext::elapsed_seconds() const {
  MutexLock lock(mutex_);
  return Seconds((phase() == BuildPhase::kDone ? entered_[kPhases - 1] : Clock::now()) - start_);
}

BuildContext::CpuTime::CpuTime(BuildContext& context, BuildPhase phase) {
  if (thread_time_is_counted) return;
  thread_time_is_counted = true;
  nanoseconds_ = &context.cpu_nanoseconds_[static_cast<size_t>(phase)];
  start_ = ThreadCpuNanoseconds();
}

BuildContext::CpuTime::~CpuTime() {
  if (nanoseconds_ == nullptr) return;
  nanoseconds_->fetch_add(ThreadCpuNanoseconds() - start_, std::memory_order_relaxed);
  thread_time_is_counted = false;
}

}  // namespace deltaray
