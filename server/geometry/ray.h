// Rays and what is found along them.

#ifndef SERVER_GEOMETRY_RAY_H_
#define SERVER_GEOMETRY_RAY_H_

#include <cstdint>
#include <limits>

#include "server/geometry/vec3.h"

namespace deltaray {

// The id of no primitive: the hit of a ray that misses, the exclusion of a ray that excludes none.
inline constexpr uint32_t kNoPrimitive = 0xFFFFFFFF;

// The points origin + t * direction for t in [t_min, t_max], both ends included, taken as exact real numbers.
//
// Origin and direction are finite; the direction need not be of length 1. t_min and t_max may be infinite, not NaN. A
// direction of length zero or t_min > t_max hits nothing.
struct Ray {
  Vec3f origin;
  float t_min = 0;
  Vec3f direction;
  float t_max = std::numeric_limits<float>::infinity();
  // A triangle that this ray passes through, or kNoPrimitive.
  uint32_t excluded_primitive = kNoPrimitive;
};

// A hit, or a miss (the default).
struct Hit {
  // Exact t, rounded to nearest even; never -0.
  float t = std::numeric_limits<float>::infinity();
  // Barycentric coordinates: the point is (1 - u - v) * v0 + u * v1 + v * v2. Rounded as t is.
  float u = 0, v = 0;
  uint32_t primitive = kNoPrimitive;
  // Whether the back of the triangle was hit: the side from which the corners are seen in clockwise order.
  bool back = false;

  bool IsHit() const { return primitive != kNoPrimitive; }
  friend bool operator==(const Hit&, const Hit&) = default;
};

// Which sides of triangles to ignore.
enum class Culling : uint8_t { kNone, kBack, kFront };

}  // namespace deltaray

#endif  // SERVER_GEOMETRY_RAY_H_
