// The geometric normal of a triangle.

#ifndef SERVER_SERVICE_TRIANGLE_NORMAL_H_
#define SERVER_SERVICE_TRIANGLE_NORMAL_H_

#include "server/geometry/triangles.h"

namespace deltaray {

// (v1 - v0) × (v2 - v0), scaled to length 1; each component within 2^-22 of the exact one, for all finite corners,
// however long, small or thin the triangle. Zero for a triangle of zero area.
Vec3f GeometricNormal(const Triangle& triangle);

}  // namespace deltaray

#endif  // SERVER_SERVICE_TRIANGLE_NORMAL_H_
