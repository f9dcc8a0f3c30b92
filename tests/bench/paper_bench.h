// The experiments of [Tang 2015], run again: its figures 1 and 2 and its table 4.

#ifndef TESTS_BENCH_PAPER_BENCH_H_
#define TESTS_BENCH_PAPER_BENCH_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"

namespace deltaray {

struct PaperBenchOptions {
  // Scenes of table 4; figures 1 and 2 use the first one.
  std::vector<std::string> scenes;
  uint32_t width = 640, height = 480;
  uint32_t build_rounds = 3;
  uint32_t render_rounds = 7;
  std::string csv;  // "-": standard output
};

absl::Status RunPaperBench(const PaperBenchOptions& options);

}  // namespace deltaray

#endif  // TESTS_BENCH_PAPER_BENCH_H_
