#include "tests/bench/measure.h"

#include <malloc.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <ctime>
#include <fstream>
#include <iostream>
#include <iterator>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "tests/scenes/load.h"

namespace deltaray {
namespace {

constexpr std::array<std::pair<std::string_view, Builder>, 5> kEngines = {{{"hybrid", Builder::kHybrid},
                                                                           {"kd_tree", Builder::kKdTree},
                                                                           {"bvh", Builder::kBvh},
                                                                           {"sbvh", Builder::kSbvh},
                                                                           {"tang2015", Builder::kTang2015}}};
constexpr std::array<std::pair<std::string_view, AccuracyLevel>, 3> kLevels = {
    {{"fast", AccuracyLevel::kFast}, {"watertight", AccuracyLevel::kWatertight}, {"exact", AccuracyLevel::kExact}}};
constexpr std::array<std::pair<std::string_view, Preset>, 4> kPresets = {
    {{"fast", Preset::kFast}, {"balanced", Preset::kBalanced}, {"best", Preset::kBest}, {"auto", Preset::kAuto}}};

template <typename T, size_t N>
std::string_view NameOf(const std::array<std::pair<std::string_view, T>, N>& names, T value) {
  return std::find_if(names.begin(), names.end(), [&](const auto& entry) { return entry.second == value; })->first;
}

template <typename T, size_t N>
absl::StatusOr<T> Parse(const std::array<std::pair<std::string_view, T>, N>& names, const char* what,
                        std::string_view name) {
  std::string known;
  for (const auto& [known_name, value] : names) {
    if (name == known_name) return value;
    absl::StrAppend(&known, known.empty() ? "" : ", ", std::string(known_name));
  }
  return absl::InvalidArgumentError(absl::StrCat("no ", what, " '", std::string(name), "'; there are ", known));
}

// An entry of /proc/self/status, such as "VmRSS:     1964 kB".
uint64_t StatusBytes(std::string_view name) {
  std::ifstream file("/proc/self/status");
  for (std::string word; file >> word;) {
    uint64_t kilobytes;
    if (word == std::string(name) + ":" && file >> kilobytes) return 1024 * kilobytes;
  }
  return 0;
}

double Seconds(clockid_t clock) {
  timespec time;
  clock_gettime(clock, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

}  // namespace

std::string_view EngineName(Builder builder) { return NameOf(kEngines, builder); }
std::string_view PresetName(Preset preset) { return NameOf(kPresets, preset); }
absl::StatusOr<Builder> ParseEngine(std::string_view name) { return Parse(kEngines, "engine", name); }
absl::StatusOr<Preset> ParsePreset(std::string_view name) { return Parse(kPresets, "preset", name); }
absl::StatusOr<AccuracyLevel> ParseLevel(std::string_view name) { return Parse(kLevels, "level", name); }

absl::StatusOr<std::optional<SimdTarget>> ParseSimdTarget(std::string_view name) {
  static constexpr std::array<std::pair<std::string_view, std::optional<SimdTarget>>, 4> kTargets = {
      {{"best", std::nullopt},
       {"sse4", SimdTarget::kSse4},
       {"avx2", SimdTarget::kAvx2},
       {"avx512", SimdTarget::kAvx512}}};
  return Parse(kTargets, "SIMD target", name);
}

absl::StatusOr<FinishedBuild> BuildOnce(const std::shared_ptr<const TriangleMesh>& mesh, const Config& config,
                                        uint32_t threads, std::optional<SimdTarget> simd_target) {
  Build::Options options;
  options.config = config;
  options.threads = threads;
  options.simd_target = simd_target;
  FinishedBuild result;
  const PeakMemory memory;
  const Stopwatch stopwatch;
  const std::shared_ptr<Build> build = Build::Start(mesh, std::move(options));
  if (absl::Status status = build->WaitDone(); !status.ok()) return status;
  stopwatch.Stop(&result.cost);
  result.snapshot = build->snapshot();
  result.statistics = build->statistics();
  result.cost.bytes = result.statistics.shape.node_bytes + result.statistics.shape.reference_bytes;
  result.cost.peak_bytes = memory.bytes();
  return result;
}

PeakMemory::PeakMemory() {
  // What was freed is to be given back, so that the build has to take it anew.
  malloc_trim(0);
  // Sets VmHWM to VmRSS.
  std::ofstream("/proc/self/clear_refs") << 5;
  start_ = StatusBytes("VmRSS");
}

uint64_t PeakMemory::bytes() const { return std::max(StatusBytes("VmHWM"), start_) - start_; }

Stopwatch::Stopwatch() : start_(std::chrono::steady_clock::now()), cpu_start_(ProcessCpuSeconds()) {}

void Stopwatch::Stop(BuildCost* cost) const {
  cost->seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  cost->cpu_seconds = ProcessCpuSeconds() - cpu_start_;
}

double Samples::Quantile(double q) const {
  std::vector<double> sorted = values_;
  std::sort(sorted.begin(), sorted.end());
  const double place = q * static_cast<double>(sorted.size() - 1);
  const auto below = static_cast<size_t>(place);
  const size_t above = std::min(below + 1, sorted.size() - 1);
  return std::lerp(sorted[below], sorted[above], place - static_cast<double>(below));
}

absl::Status Interleave(size_t count, size_t rounds, const std::function<absl::Status(size_t)>& measure) {
  for (size_t round = 0; round < rounds; ++round) {
    for (size_t i = 0; i < count; ++i) {
      if (absl::Status status = measure((round + i) % count); !status.ok()) return status;
    }
  }
  return absl::OkStatus();
}

double ThreadCpuSeconds() { return Seconds(CLOCK_THREAD_CPUTIME_ID); }
double ProcessCpuSeconds() { return Seconds(CLOCK_PROCESS_CPUTIME_ID); }

absl::StatusOr<std::vector<Scene>> LoadScenes(const std::vector<std::string>& names) {
  std::vector<Scene> scenes;
  for (const std::string& name : names) {
    absl::StatusOr<TriangleMesh> mesh = LoadScene(name);
    if (!mesh.ok()) return mesh.status();
    scenes.push_back({name, std::make_shared<const TriangleMesh>(*std::move(mesh))});
  }
  return scenes;
}

absl::Status WriteLines(const std::string& path, const std::vector<std::string>& lines) {
  std::ofstream file;
  if (path != "-") file.open(path);
  std::ostream& out = path == "-" ? std::cout : file;
  std::copy(lines.begin(), lines.end(), std::ostream_iterator<std::string>(out, "\n"));
  out.flush();
  return out ? absl::OkStatus() : absl::UnavailableError(absl::StrCat("cannot write ", path));
}

}  // namespace deltaray
