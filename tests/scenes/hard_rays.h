// Rays on which ray tracers are known to fail. All are finite and legal; answers to them are a matter of one bit.

#ifndef TESTS_SCENES_HARD_RAYS_H_
#define TESTS_SCENES_HARD_RAYS_H_

#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "server/geometry/ray.h"
#include "server/mesh/triangle_mesh.h"
#include "server/tree/tree.h"

namespace deltaray {

struct HardRays {
  std::string_view name;
  // Makes `count` rays at `mesh`, which has at least one triangle.
  std::vector<Ray> (*make)(const TriangleMesh& mesh, uint32_t count, uint64_t seed);
};

// The families: aimed at vertices; aimed at edges; along an axis within faces of boxes, with +0 and -0 in the other
// components; with the origin on a vertex, an edge or inside a triangle; with origins 1e3 to 1e9 sizes away; with
// directions of length 1e-20 to 1e20; with an interval that begins behind the origin or ends at a vertex; in the plane
// of a triangle; along an axis but for components down to 1e-44; with random bits.
std::span<const HardRays> HardRayFamilies();

// Each ray of `rays` that hits something, with t_max equal to the t of its closest hit, then with t_min equal to it,
// then with that primitive excluded.
std::vector<Ray> RaysEndingAtHits(const Tree& tree, std::span<const Ray> rays);

}  // namespace deltaray

#endif  // TESTS_SCENES_HARD_RAYS_H_
