#include "server/build/memory_estimate.h"

namespace deltaray {
namespace {

// Of a build that is small: arenas, tasks, and what malloc keeps.
constexpr uint64_t kFixedBytes = uint64_t{1} << 20;
// For each reference that there may be: boxes and indices, the binary trees over them, the tree laid out twice.
constexpr double kClusteredBytes = 320;
constexpr double kSplitBytes = 330;

}  // namespace

uint64_t EstimateBuildBytes(const Config& config, uint64_t triangles) {
  const bool clustered = config.builder == Builder::kHybrid && config.preset != Preset::kFast;
  const double references = static_cast<double>(triangles) * (1 + config.duplication_budget);
  return kFixedBytes + static_cast<uint64_t>(references * (clustered ? kClusteredBytes : kSplitBytes));
}

}  // namespace deltaray
