#include "server/build/memory_estimate.h"

#include <algorithm>

namespace deltaray {
namespace {

// Of a build that is small: arenas, tasks, and what malloc keeps.
constexpr uint64_t kFixedBytes = uint64_t{1} << 20;
// For each reference that there may be: boxes and indices, the binary trees over them, the tree laid out twice.
constexpr double kBytes = 330;
// Of a lazy tree also where its leaves come from, and the version that a newer one replaces.
constexpr double kLazyBytes = 420;
// For each δ-leaf that there may be.
constexpr double kDeltaLeafBytes = 30;
constexpr double kLazyDeltaLeafBytes = 180;
// What half a huge page is for each of the arrays at once; small arrays have none.
constexpr double kPageBytes = 6 << 20;
constexpr double kPageShare = 0.25;

}  // namespace

uint64_t EstimateBuildBytes(const Config& config, uint64_t triangles) {
  const double references = static_cast<double>(triangles) * (1 + config.duplication_budget);
  // Where the mesh is to choose it, it will be no less than this.
  const uint32_t delta =
      config.delta == kDeltaByMesh ? MakeConfig(Builder::kHybrid, Preset::kFast).delta : config.delta;
  const bool has_delta_leaves = config.builder == Builder::kHybrid || config.builder == Builder::kTang2015;
  // Most are of more than half of δ.
  const double delta_leaves = has_delta_leaves ? references * std::min(1.0, 2.0 / delta) : 0;
  const double bytes = references * (config.lazy ? kLazyBytes : kBytes) +
                       delta_leaves * (config.lazy ? kLazyDeltaLeafBytes : kDeltaLeafBytes);
  return kFixedBytes + static_cast<uint64_t>(bytes + std::min(kPageBytes, kPageShare * bytes));
}

}  // namespace deltaray
