// Adds simple shapes to a mesh.

#ifndef TESTS_SCENES_SHAPES_H_
#define TESTS_SCENES_SHAPES_H_

#include <array>
#include <cstdint>

#include "server/mesh/triangle_mesh.h"
#include "tests/scenes/random.h"

namespace deltaray {

// Three perpendicular vectors of length 1.
using Frame = std::array<Vec3d, 3>;

// A frame whose first axis is `axis`, of length 1, and whose second one is random.
Frame RandomFrame(Vec3d axis, Random& random);

// Adds one triangle with vertices of its own.
void AddTriangle(TriangleMesh* mesh, Vec3d a, Vec3d b, Vec3d c);

// Adds the parallelogram a, a + u, a + u + v, a + v as two triangles.
void AddParallelogram(TriangleMesh* mesh, Vec3d a, Vec3d u, Vec3d v);

// Adds a box as 12 triangles over 8 vertices, seen counter-clockwise from outside. half[i]: half the size along
// frame[i].
void AddBox(TriangleMesh* mesh, Vec3d centre, const Frame& frame, Vec3d half);

// Adds a sphere of `rings` times 2·rings quads (triangles at the poles): 4·rings·(rings - 1) triangles. REQUIRES:
// rings >= 2.
void AddSphere(TriangleMesh* mesh, Vec3d centre, double radius, uint32_t rings);

}  // namespace deltaray

#endif  // TESTS_SCENES_SHAPES_H_
