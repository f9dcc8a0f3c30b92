// What a build counts and measures, where it happens.

#ifndef SERVER_BUILD_STATISTICS_H_
#define SERVER_BUILD_STATISTICS_H_

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "server/build/config.h"
#include "server/tree/tree.h"

namespace deltaray {

enum class BuildPhase : uint8_t { kQueued, kReferences, kTop, kDeltaLeaves, kLayout, kDone };

struct PhaseTime {
  BuildPhase phase = BuildPhase::kQueued;
  double wall_seconds = 0;
  double cpu_seconds = 0;  // summed over threads
};

// A build as it goes. All numbers only grow.
struct BuildProgress {
  BuildPhase phase = BuildPhase::kQueued;
  uint64_t references_placed = 0;
  uint64_t triangles = 0;
  uint64_t delta_leaves = 0;  // final once past kTop
  uint64_t delta_leaves_built = 0;
  bool lazy = false;  // whether a δ-leaf is built when the first ray reaches it
  double elapsed_seconds = 0;
};

// The ways to build a δ-leaf, of which the cheapest is kept.
enum class DeltaLeafCandidate : uint8_t { kCombinedCost, kAreaOnly, kDistanceOnly, kTopDown };

struct BuildStatistics {
  // What the build was asked to be, and with Preset::kAuto the values that were chosen.
  Config config;
  // Preset::kAuto: what was chosen and why.
  std::vector<std::string> choices;
  std::vector<PhaseTime> phases;
  double provisional_seconds = 0;
  double total_seconds = 0;  // 0: not finished
  uint32_t threads = 0;
  uint64_t triangles = 0;  // without degenerate ones
  uint64_t spatial_splits = 0;
  uint64_t object_splits = 0;
  uint64_t median_splits = 0;
  uint64_t delta_leaves = 0;
  uint64_t delta_leaves_built = 0;
  // Entry i counts δ-leaves with 2^i to 2^(i+1) - 1 references.
  std::vector<uint64_t> delta_leaf_size_histogram;
  std::array<uint64_t, 4> candidate_wins{};  // by DeltaLeafCandidate
  TreeShape shape;
  uint64_t peak_build_bytes = 0;
};

}  // namespace deltaray

#endif  // SERVER_BUILD_STATISTICS_H_
