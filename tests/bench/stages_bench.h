// How fast rays are answered at each stage of a build, and how soon they are at all.

#ifndef TESTS_BENCH_STAGES_BENCH_H_
#define TESTS_BENCH_STAGES_BENCH_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"

namespace deltaray {

struct StagesBenchOptions {
  std::vector<std::string> scenes;
  std::vector<std::string> rays;
  // Side of the square of camera rays; see MakeRaySet.
  uint32_t size = 1024;
  uint32_t rounds = 5;
  std::string csv;  // "-": standard output
};

// Fails where an answer of any stage differs by one bit from that of the final tree.
absl::Status RunStagesBench(const StagesBenchOptions& options);

}  // namespace deltaray

#endif  // TESTS_BENCH_STAGES_BENCH_H_
