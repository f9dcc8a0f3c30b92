// How building and tracing grow with the number of triangles, beside Embree.

#ifndef TESTS_BENCH_SCALE_BENCH_H_
#define TESTS_BENCH_SCALE_BENCH_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"

namespace deltaray {

struct ScaleBenchOptions {
  std::vector<std::string> scenes;  // terrain, soup
  std::vector<uint32_t> triangles;  // about: a terrain has a whole number of squares either way
  std::vector<std::string> rays;
  std::vector<std::string> levels;
  std::string preset;
  uint32_t threads = 0;  // to build with; 0: all cores. Rays are traced by one
  uint32_t size = 512;   // see MakeRaySet
  uint32_t build_rounds = 1;
  uint32_t rounds = 5;
  std::string csv;  // "-": standard output
};

// Fails as RunKernelBench does.
absl::Status RunScaleBench(const ScaleBenchOptions& options);

}  // namespace deltaray

#endif  // TESTS_BENCH_SCALE_BENCH_H_
