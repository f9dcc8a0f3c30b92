// Meshes and rays on which ray tracing is known to fail, by name: one family per failure, and a few ordinary ones
// beside them. Tests and benchmarks run the same.

#ifndef TESTS_STABILITY_FAMILIES_H_
#define TESTS_STABILITY_FAMILIES_H_

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "server/geometry/ray.h"
#include "server/mesh/triangle_mesh.h"

namespace deltaray {

struct StabilityFamily {
  std::string name;
  std::shared_ptr<const TriangleMesh> mesh;
  std::vector<Ray> rays;
};

// The names of all families, in the order of README.md.
std::vector<std::string> StabilityFamilyNames();

// The family with `ray_count` rays, always the same ones. NOT_FOUND where its mesh is a file that is missing, saying
// how to get it; INVALID_ARGUMENT where there is none of that name.
absl::StatusOr<StabilityFamily> MakeStabilityFamily(std::string_view name, uint32_t ray_count);

}  // namespace deltaray

#endif  // TESTS_STABILITY_FAMILIES_H_
