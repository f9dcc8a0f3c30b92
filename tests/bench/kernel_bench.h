// How fast rays are answered in-process: every kernel of deltaray beside Embree's calls.

#ifndef TESTS_BENCH_KERNEL_BENCH_H_
#define TESTS_BENCH_KERNEL_BENCH_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"

namespace deltaray {

struct KernelBenchOptions {
  std::vector<std::string> scenes;
  std::vector<std::string> rays;
  std::vector<std::string> levels;
  std::vector<uint32_t> threads;
  std::string preset;
  std::string simd;
  // Side of the square of camera rays; see MakeRaySet.
  uint32_t size = 1024;
  // Rays that a kernel is given at once.
  uint32_t chunk = 1024;
  uint32_t rounds = 5;
  std::string csv;  // "-": standard output
};

// Fails where a kernel's answers are not those of the exact level: by one bit at that level itself, on more than a few
// rays per million elsewhere.
absl::Status RunKernelBench(const KernelBenchOptions& options);

}  // namespace deltaray

#endif  // TESTS_BENCH_KERNEL_BENCH_H_
