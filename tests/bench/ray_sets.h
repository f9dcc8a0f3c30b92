// The ray sets that kernels are measured with, by name.

#ifndef TESTS_BENCH_RAY_SETS_H_
#define TESTS_BENCH_RAY_SETS_H_

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "server/geometry/ray.h"
#include "server/mesh/triangle_mesh.h"
#include "server/tree/tree.h"
#include "tests/bench/kernel.h"

namespace deltaray {

struct RaySet {
  std::string name;
  Question question = Question::kClosestHit;
  // Neighbours in the set are close to each other in space.
  bool coherent = false;
  std::vector<Ray> rays;
};

// The names that MakeRaySet knows: camera, bounce, chords, shadow, miss.
std::vector<std::string> RaySetNames();

// Makes a set for `mesh`: camera rays for a picture of size × size pixels; from each of their hits one diffuse bounce,
// in random order, or one ray to a light, in order; size × size chords of the bounding sphere, or rays that
// lead away from it, which cost all but nothing to trace. `tree` answers where the
// camera rays hit. INVALID_ARGUMENT, listing the names, where there is no such set.
absl::StatusOr<RaySet> MakeRaySet(std::string_view name, const TriangleMesh& mesh, const Tree& tree, uint32_t size);

}  // namespace deltaray

#endif  // TESTS_BENCH_RAY_SETS_H_
