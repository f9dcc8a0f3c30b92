// What building costs, and what it gives: the hybrid, the baselines, and Embree.

#ifndef TESTS_BENCH_BUILD_BENCH_H_
#define TESTS_BENCH_BUILD_BENCH_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"

namespace deltaray {

struct BuildBenchOptions {
  std::vector<std::string> scenes;
  std::vector<std::string> engines;  // "embree" has qualities of its own in place of presets: medium and high
  std::vector<std::string> presets;
  std::vector<uint32_t> threads;
  uint32_t rounds = 5;
  std::string csv;  // "-": standard output
};

absl::Status RunBuildBench(const BuildBenchOptions& options);

}  // namespace deltaray

#endif  // TESTS_BENCH_BUILD_BENCH_H_
