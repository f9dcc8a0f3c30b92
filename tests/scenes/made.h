// Large scenes made from a seed, each hard on a builder in its own way.

#ifndef TESTS_SCENES_MADE_H_
#define TESTS_SCENES_MADE_H_

#include <cstdint>

#include "server/mesh/triangle_mesh.h"

namespace deltaray {

// A town of 3 km by 3 km in metres: a ground of two triangles, blocks² boxes from 0.3 m to 300 m, each turned about the
// vertical, and `cables` slivers of 2 cm by up to 1.5 km, of two triangles each. The defaults give 102,002 triangles.
TriangleMesh City(uint32_t blocks = 90, uint32_t cables = 2400, uint64_t seed = 1);

// Triangles at random places in the unit box, turned at random, with sizes over three decades. The largest are such
// that a ray through the box meets about as many triangles however many there are: 0.05 for the default.
TriangleMesh Soup(uint32_t triangles = 200'000, uint64_t seed = 2);

// A height field over width × depth squares of side 1, with hills of all sizes: 2 · width · depth triangles.
TriangleMesh Terrain(uint32_t width, uint32_t depth, uint64_t seed = 3);

}  // namespace deltaray

#endif  // TESTS_SCENES_MADE_H_
