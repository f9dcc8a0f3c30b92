// A box in two vector registers, for loops that unite many boxes.

#ifndef SERVER_GEOMETRY_PACKED_BOUNDS_H_
#define SERVER_GEOMETRY_PACKED_BOUNDS_H_

#include <algorithm>
#include <cstring>
#include <limits>

#include "server/geometry/bounds.h"
#include "server/geometry/vec3.h"

namespace deltaray {

// x, y and z of a point; the fourth lane is 0, so that no arithmetic on it is slow. Four lanes are what every machine's
// baseline has: no dispatch is needed for them.
using PackedFloats = float __attribute__((vector_size(16)));
using PackedInts = int __attribute__((vector_size(16)));

// Where one operand is NaN, both give `b`.
inline PackedFloats Least(PackedFloats a, PackedFloats b) { return a < b ? a : b; }
inline PackedFloats Greatest(PackedFloats a, PackedFloats b) { return a > b ? a : b; }

inline PackedFloats Pack(const Vec3f& v) { return PackedFloats{v.x, v.y, v.z, 0}; }
inline Vec3f Unpack(PackedFloats v) { return {v[0], v[1], v[2]}; }

// 1 over the longest side of a box, so that areas within the box, scaled by it, neither overflow nor vanish.
inline float UnitScale(const Bounds& bounds) {
  const int axis = bounds.WidestAxis();
  const double longest = static_cast<double>(bounds.max[axis]) - static_cast<double>(bounds.min[axis]);
  return static_cast<float>(1 / std::max(longest, double{std::numeric_limits<float>::min()}));
}

// As Bounds.
struct PackedBounds {
  PackedFloats min{Bounds::kInfinity, Bounds::kInfinity, Bounds::kInfinity, 0};
  PackedFloats max{-Bounds::kInfinity, -Bounds::kInfinity, -Bounds::kInfinity, 0};

  PackedBounds() = default;
  PackedBounds(PackedFloats min, PackedFloats max) : min(min), max(max) {}
  explicit PackedBounds(const Bounds& b) : min(Pack(b.min)), max(Pack(b.max)) {}
  // Bounds that four more bytes follow, of any value.
  static PackedBounds Load(const void* bounds) {
    PackedInts min, max;
    std::memcpy(&min, bounds, sizeof(min));
    std::memcpy(&max, static_cast<const char*>(bounds) + sizeof(Vec3f), sizeof(max));
    constexpr PackedInts kThree{-1, -1, -1, 0};
    return {reinterpret_cast<PackedFloats>(min & kThree), reinterpret_cast<PackedFloats>(max & kThree)};
  }

  void Extend(PackedFloats p) {
    min = Least(p, min);
    max = Greatest(p, max);
  }
  void Extend(const PackedBounds& b) {
    min = Least(b.min, min);
    max = Greatest(b.max, max);
  }

  // A quarter of min + max: half the centre, which cannot overflow, and neither can a difference of two.
  PackedFloats HalfCentre() const { return 0.25f * min + 0.25f * max; }

  // Half of the surface area of the box times `scale`. Anything where the box is empty. Halves, since a difference may
  // overflow; and the difference first, which is exact or nearly so however far from 0 the box lies.
  float HalfArea(float scale) const {
    const PackedFloats d = (2 * scale) * (0.5f * max - 0.5f * min);
    return d[0] * d[1] + d[1] * d[2] + d[2] * d[0];
  }

  explicit operator Bounds() const { return {Unpack(min), Unpack(max)}; }
};

}  // namespace deltaray

#endif  // SERVER_GEOMETRY_PACKED_BOUNDS_H_
