// Kernels measured side by side on one set of rays, their answers compared.

#ifndef TESTS_BENCH_KERNEL_RACE_H_
#define TESTS_BENCH_KERNEL_RACE_H_

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "tests/bench/kernel.h"
#include "tests/bench/kernel_table.h"
#include "tests/bench/ray_sets.h"

namespace deltaray {

struct Racer {
  KernelRow row;  // mrays_s and spread: filled in by Race
  std::shared_ptr<const Kernel> kernel;
};

struct RaceOptions {
  uint32_t chunk = 1024;  // rays that a kernel is given at once
  uint32_t rounds = 5;
};

// Measures all racers, interleaved, and writes their rows to standard error as they are done. INTERNAL where the
// answers of one are not those of `tree` at the exact level: by any bit of them at that level itself, elsewhere on more
// than 300 rays per million by hit or miss, or by more than 1e-3 of t. Nothing is measured where there are no rays.
absl::Status Race(const RaySet& set, const Tree& tree, const RaceOptions& options, std::vector<Racer>* racers);

}  // namespace deltaray

#endif  // TESTS_BENCH_KERNEL_RACE_H_
