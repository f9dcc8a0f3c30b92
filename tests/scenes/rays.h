// Rays as they come in use, each set made from a seed.

#ifndef TESTS_SCENES_RAYS_H_
#define TESTS_SCENES_RAYS_H_

#include <cstdint>
#include <vector>

#include "server/geometry/bounds.h"
#include "server/geometry/ray.h"
#include "server/mesh/triangle_mesh.h"
#include "server/tree/tree.h"

namespace deltaray {

// One ray through the centre of each of width × height pixels, row by row from the top, of a pinhole camera that sees
// all of `bounds` from the front (+z), a little from the right and above; y is up.
std::vector<Ray> CameraRays(const Bounds& bounds, uint32_t width, uint32_t height);

// `count` rays between two random points of the sphere round `bounds`.
std::vector<Ray> ChordRays(const Bounds& bounds, uint32_t count, uint64_t seed);

// From each hit of `rays` in `tree` one ray, cosine-distributed about the normal that faces the viewer, in random
// order. t_min keeps off the surface by 1e-4 of the hit's distance.
std::vector<Ray> BounceRays(const TriangleMesh& mesh, const Tree& tree, const std::vector<Ray>& rays, uint64_t seed);

// From each hit of `rays` in `tree` one ray towards a light above the mesh, in order; t = 1 is the light.
std::vector<Ray> ShadowRays(const TriangleMesh& mesh, const Tree& tree, const std::vector<Ray>& rays);

// The box round all vertices of triangles. All zero for a mesh without triangles.
Bounds MeshBounds(const TriangleMesh& mesh);

}  // namespace deltaray

#endif  // TESTS_SCENES_RAYS_H_
