// Building and timing, the same for all benchmarks.

#ifndef TESTS_BENCH_MEASURE_H_
#define TESTS_BENCH_MEASURE_H_

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "server/build/build.h"
#include "server/tree/simd_target.h"

namespace deltaray {

// The engines by the names that the CSV files use: hybrid, kd_tree, bvh, sbvh, tang2015.
std::string_view EngineName(Builder builder);
std::string_view PresetName(Preset preset);
absl::StatusOr<Builder> ParseEngine(std::string_view name);
absl::StatusOr<Preset> ParsePreset(std::string_view name);

// What a build took.
struct BuildCost {
  double seconds = 0;
  double cpu_seconds = 0;   // of all threads
  uint64_t bytes = 0;       // of the finished structure, without the mesh
  uint64_t peak_bytes = 0;  // the most that the process grew by while building; the finished structure included
};

// One build from start to end.
struct FinishedBuild {
  std::shared_ptr<const TreeSnapshot> snapshot;
  BuildStatistics statistics;
  BuildCost cost;
};

// `simd_target`: what the tree may use of the machine; by default the best that there is.
absl::StatusOr<FinishedBuild> BuildOnce(const std::shared_ptr<const TriangleMesh>& mesh, const Config& config,
                                        uint32_t threads, std::optional<SimdTarget> simd_target = std::nullopt);

absl::StatusOr<AccuracyLevel> ParseLevel(std::string_view name);  // fast, watertight, exact

// "best" (nothing), "sse4", "avx2" or "avx512".
absl::StatusOr<std::optional<SimdTarget>> ParseSimdTarget(std::string_view name);

// Measures what passes between its making and the call of Stop.
class Stopwatch {
 public:
  Stopwatch();
  // Sets cost->seconds and cost->cpu_seconds.
  void Stop(BuildCost* cost) const;

 private:
  const std::chrono::steady_clock::time_point start_;
  const double cpu_start_;
};

// Measures how much larger the resident memory of the process has been since this was made. Two engines count their
// memory by different rules; this counts what either takes from the machine.
class PeakMemory {
 public:
  PeakMemory();
  uint64_t bytes() const;

 private:
  uint64_t start_;
};

// Repeated measurements of one thing.
class Samples {
 public:
  void Add(double value) { values_.push_back(value); }
  double median() const { return Quantile(0.5); }
  // The quarters: half of the values lie between them.
  double low() const { return Quantile(0.25); }
  double high() const { return Quantile(0.75); }
  // The distance of the quarters, relative to the median.
  double spread() const { return (high() - low()) / median(); }
  // The value below which a part q of the values lies, from 0 to 1; between two values by interpolation.
  double Quantile(double q) const;

 private:
  std::vector<double> values_;
};

// Calls measure(i) for i in [0, count) in `rounds` rounds, each of which starts with another i, so that what drifts on
// the machine meets all alike. Stops at the first error.
absl::Status Interleave(size_t count, size_t rounds, const std::function<absl::Status(size_t)>& measure);

// Processor time of the calling thread, and of all threads of this process.
double ThreadCpuSeconds();
double ProcessCpuSeconds();

// Loads scenes by name, each once and all before anything is measured.
struct Scene {
  std::string name;
  std::shared_ptr<const TriangleMesh> mesh;
};
absl::StatusOr<std::vector<Scene>> LoadScenes(const std::vector<std::string>& names);

// Writes `lines` to `path`; "-" is standard output.
absl::Status WriteLines(const std::string& path, const std::vector<std::string>& lines);

}  // namespace deltaray

#endif  // TESTS_BENCH_MEASURE_H_
