// Speed against accuracy: every family of tests/stability/ in every structure and at every level, beside Embree, judged
// by exact arithmetic.

#ifndef TESTS_BENCH_ACCURACY_BENCH_H_
#define TESTS_BENCH_ACCURACY_BENCH_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"

namespace deltaray {

struct AccuracyBenchOptions {
  std::vector<std::string> families;    // empty: all
  std::vector<std::string> structures;  // hybrid, kd_tree, bvh, sbvh, tang2015, embree
  uint32_t rays = 20'000;               // of each family
  uint32_t rounds = 3;
  std::string csv;  // "-": standard output
};

// Writes a row for each family, structure and level. INTERNAL where an answer at the exact level is wrong.
absl::Status RunAccuracyBench(const AccuracyBenchOptions& options);

}  // namespace deltaray

#endif  // TESTS_BENCH_ACCURACY_BENCH_H_
