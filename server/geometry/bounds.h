// An axis-aligned box.

#ifndef SERVER_GEOMETRY_BOUNDS_H_
#define SERVER_GEOMETRY_BOUNDS_H_

#include <algorithm>
#include <limits>

#include "server/geometry/vec3.h"

namespace deltaray {

// A closed box. Default-constructed it is empty: min = +inf, max = -inf. A box without width in an axis is not empty.
struct Bounds {
  Vec3f min{kInfinity, kInfinity, kInfinity};
  Vec3f max{-kInfinity, -kInfinity, -kInfinity};

  static constexpr float kInfinity = std::numeric_limits<float>::infinity();

  bool IsEmpty() const { return min.x > max.x || min.y > max.y || min.z > max.z; }

  void Extend(Vec3f p) {
    for (int axis = 0; axis < 3; ++axis) {
      min[axis] = std::min(min[axis], p[axis]);
      max[axis] = std::max(max[axis], p[axis]);
    }
  }
  void Extend(const Bounds& b) {
    for (int axis = 0; axis < 3; ++axis) {
      min[axis] = std::min(min[axis], b.min[axis]);
      max[axis] = std::max(max[axis], b.max[axis]);
    }
  }

  // Twice the centre along `axis`, in double so that it neither rounds nor overflows.
  double DoubledCentre(int axis) const { return static_cast<double>(min[axis]) + static_cast<double>(max[axis]); }

  // Half of the surface area, in double so that it does not overflow. 0 for an empty box.
  double HalfArea() const {
    if (IsEmpty()) return 0;
    const Vec3d d = static_cast<Vec3d>(max) - static_cast<Vec3d>(min);
    return d.x * d.y + d.y * d.z + d.z * d.x;
  }

  // The axis in which the box is widest; the first of equals.
  int WidestAxis() const {
    const Vec3d d = static_cast<Vec3d>(max) - static_cast<Vec3d>(min);
    return d.x >= d.y && d.x >= d.z ? 0 : d.y >= d.z ? 1 : 2;
  }

  bool Contains(const Bounds& b) const {
    for (int axis = 0; axis < 3; ++axis) {
      if (b.min[axis] < min[axis] || b.max[axis] > max[axis]) return false;
    }
    return true;
  }

  friend bool operator==(const Bounds&, const Bounds&) = default;
};

inline Bounds Union(Bounds a, const Bounds& b) {
  a.Extend(b);
  return a;
}

// The common part of two boxes; empty where they do not touch.
inline Bounds Intersection(const Bounds& a, const Bounds& b) {
  Bounds r;
  for (int axis = 0; axis < 3; ++axis) {
    r.min[axis] = std::max(a.min[axis], b.min[axis]);
    r.max[axis] = std::min(a.max[axis], b.max[axis]);
  }
  return r.IsEmpty() ? Bounds() : r;
}

}  // namespace deltaray

#endif  // SERVER_GEOMETRY_BOUNDS_H_
