// All that decides how a tree is built.

#ifndef SERVER_BUILD_CONFIG_H_
#define SERVER_BUILD_CONFIG_H_

#include <cstdint>

#include "absl/status/status.h"

namespace deltaray {

enum class Builder : uint8_t { kHybrid, kKdTree, kBvh, kSbvh, kTang2015 };
// kAuto: what the mesh needs, see ChooseConfig. The same as kBalanced for every builder but the hybrid.
enum class Preset : uint8_t { kFast, kBalanced, kBest, kAuto };

// A delta that is to be chosen by the mesh. Only for the hybrid with Preset::kAuto.
inline constexpr uint32_t kDeltaByMesh = 0;

// Answers, but for roundings at AccuracyLevel::kFast, do not depend on any of this; speed, memory and build time do.
// The values here are the balanced hybrid's; other presets and builders are made by MakeConfig.
struct Config {
  Preset preset = Preset::kBalanced;
  Builder builder = Builder::kHybrid;

  // δ: a node of the top with at most this many references becomes a δ-leaf. 1 to 4096. [Tang 2015], table 1.
  uint32_t delta = 32;
  // α: weight of area against distance in the clustering cost. 0 to 1. [Tang 2015], section 3.2.
  double alpha = 0.6;
  // Ct and Ci of the clustering cost, as printed, where Ct adds the same to all pairs. 0.001 to 1000. [Tang 2015],
  // section 5.1.
  double cluster_traversal_cost = 1;
  double cluster_intersection_cost = 80;
  // Ct and Ci of the surface area heuristic that splits, leaves and the choice among candidates go by. 0.001 to 1000.
  double traversal_cost = 1;
  double intersection_cost = 1;
  // Most references of a leaf of the binary BVH, 1 to 255; the wide tree's leaves are planned anew, of up to 8.
  uint32_t max_leaf_size = 8;
  // A spatial split is tried only where the children of the best object split overlap by more than this part of the
  // root's area. 0: always; 1: never. [Stich 2009], section 4.5.
  double spatial_split_gate = 1e-3;
  // Spatial splits may add at most this many references per triangle. 0 to 16.
  double duplication_budget = 0.5;
  // Build δ-leaves only when the first ray reaches them. Hybrid only.
  bool lazy = false;
};

// The values of a preset for a builder.
Config MakeConfig(Builder builder, Preset preset);

// INVALID_ARGUMENT, naming field and range, where a value is out of range.
absl::Status Validate(const Config& config);

}  // namespace deltaray

#endif  // SERVER_BUILD_CONFIG_H_
