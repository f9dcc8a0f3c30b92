#include "server/build/config.h"

#include <charconv>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "server/build/sah.h"

namespace deltaray {
namespace {

// Written so that NaN is out of range.
absl::Status CheckRange(const char* field, double value, double least, double most) {
  if (value >= least && value <= most) return absl::OkStatus();
  // As short as tells it from all other numbers: what is just over a limit is not to look like it.
  char text[32];
  const absl::string_view given(text, static_cast<size_t>(std::to_chars(text, text + sizeof(text), value).ptr - text));
  return absl::InvalidArgumentError(absl::StrCat(field, " is ", given, "; it must be ", least, " to ", most));
}

}  // namespace

Config MakeConfig(Builder builder, Preset preset) {
  Config config;
  config.builder = builder;
  config.preset = preset;
  switch (builder) {
    case Builder::kHybrid:
      if (preset == Preset::kBest) {
        config.spatial_split_gate = 1e-5;
        config.duplication_budget = 1;
      }
      if (preset == Preset::kAuto) config.delta = kDeltaByMesh;
      if (preset == Preset::kFast) {
        // δ-leaves of one group: there is no tree in them to look for.
        config.delta = 1u << kLeafGroupShift;
        config.spatial_split_gate = 1;
        config.duplication_budget = 0;
      }
      break;
    case Builder::kKdTree:
      config.duplication_budget = 8;
      break;
    case Builder::kBvh:
      config.spatial_split_gate = 1;
      config.duplication_budget = 0;
      break;
    case Builder::kSbvh:
      config.spatial_split_gate = 1e-5;
      config.duplication_budget = 1;
      break;
    case Builder::kTang2015:
      config.intersection_cost = 80;
      config.max_leaf_size = 1;
      config.spatial_split_gate = 0;
      config.duplication_budget = 8;
      break;
  }
  return config;
}

absl::Status Validate(const Config& config) {
  const bool delta_by_mesh =
      config.delta == kDeltaByMesh && config.preset == Preset::kAuto && config.builder == Builder::kHybrid;
  for (const absl::Status& status : {
           CheckRange("delta", delta_by_mesh ? 1 : config.delta, 1, 4096),
           CheckRange("alpha", config.alpha, 0, 1),
           CheckRange("cluster_traversal_cost", config.cluster_traversal_cost, 0.001, 1000),
           CheckRange("cluster_intersection_cost", config.cluster_intersection_cost, 0.001, 1000),
           CheckRange("traversal_cost", config.traversal_cost, 0.001, 1000),
           CheckRange("intersection_cost", config.intersection_cost, 0.001, 1000),
           CheckRange("max_leaf_size", config.max_leaf_size, 1, 255),
           CheckRange("spatial_split_gate", config.spatial_split_gate, 0, 1),
           CheckRange("duplication_budget", config.duplication_budget, 0, 16),
       }) {
    if (!status.ok()) return status;
  }
  if (config.lazy && config.builder != Builder::kHybrid) {
    return absl::InvalidArgumentError("lazy is set; only the hybrid can be built lazily");
  }
  return absl::OkStatus();
}

}  // namespace deltaray
