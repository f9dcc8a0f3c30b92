#include "server/store/build_memory.h"

#include <algorithm>
#include <cstdint>
#include <string>

#include "absl/strings/str_cat.h"
#include "server/build/memory_estimate.h"

namespace deltaray {
namespace {

uint64_t PeakBytes(const MeshInfo& info, const Config& config) {
  // Positions, indices, face ids and group ids; once more as they are read from the file, before the build.
  const uint64_t mesh = 12 * info.vertex_count + 20 * info.triangle_count;
  return mesh + std::max(info.stored_bytes, EstimateBuildBytes(config, info.triangle_count));
}

std::string Description(const MeshInfo& info) {
  return absl::StrCat("mesh ", info.id, " of ", info.triangle_count, " triangles");
}

}  // namespace

absl::Status CheckBuildFits(const MeshInfo& info, const Config& config, const TreeBudget& budget) {
  return budget.CheckFits(PeakBytes(info, config), Description(info));
}

absl::StatusOr<std::shared_ptr<TreeBudget::Reservation>> ReserveForBuild(const MeshInfo& info, const Config& config,
                                                                         TreeBudget* budget,
                                                                         const std::function<bool()>& cancelled) {
  return budget->Reserve(PeakBytes(info, config), Description(info), cancelled);
}

}  // namespace deltaray
