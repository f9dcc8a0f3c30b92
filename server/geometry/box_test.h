// The conservative ray-box test.

#ifndef SERVER_GEOMETRY_BOX_TEST_H_
#define SERVER_GEOMETRY_BOX_TEST_H_

#include <algorithm>
#include <cmath>
#include <limits>

#include "server/geometry/bounds.h"
#include "server/geometry/ray.h"
#include "server/geometry/vec3.h"

namespace deltaray {

// Every bound of t made from one subtraction, one reciprocal and one product is off by less than this part of itself,
// the rounding of the correction included: at most 5 roundings of 2^-53.
inline constexpr double kSlabRounding = 0x1p-50;

// Bounds of the parameter t, widened: no t of the exact interval lies outside. Empty where !(first <= last).
struct Interval {
  double first, last;

  bool IsEmpty() const { return !(first <= last); }  // NaN is empty
};

// What the box tests of one ray have in common.
class BoxTest {
 public:
  explicit BoxTest(const Ray& ray) : origin_(static_cast<Vec3d>(ray.origin)), first_(ray.t_min), last_(ray.t_max) {
    for (int axis = 0; axis < 3; ++axis) {
      const double direction = ray.direction[axis];
      // ±0 counts as moving upward at infinite 1 / direction: plane distances become -inf or +inf, and NaN where the
      // origin lies in the plane, which the comparisons below pass over.
      negative_[axis] = direction < 0;
      inverse_[axis] = direction == 0 ? std::numeric_limits<double>::infinity() : 1 / direction;
    }
    // Finite ends, so that the interval of a box that a ray with a zero component passes beside, [inf, inf], is empty.
    // No ray is in a finite box that late: t there is at most 2^129 / 2^-149.
    last_ = std::min(last_, kLatest);
    first_ = std::max(first_, -kLatest);
  }

  // An interval that holds every t for which the ray's point lies in the closed `box`, t_min <= t <= t_max and t <=
  // limit. Empty only if there is none. `limit` may be infinite; an empty box gives an empty interval.
  Interval operator()(const Bounds& box, double limit) const {
    return (*this)(static_cast<Vec3d>(box.min), static_cast<Vec3d>(box.max), limit);
  }
  // The same of a box with corners in double, of magnitude up to 2^129 as those of float.
  Interval operator()(Vec3d min, Vec3d max, double limit) const {
    double first = first_, last = std::min(last_, limit);
    for (int axis = 0; axis < 3; ++axis) {
      const double near = Crossing(axis, negative_[axis] ? max[axis] : min[axis]);
      const double far = Crossing(axis, negative_[axis] ? min[axis] : max[axis]);
      // The order of the operands matters: a NaN on the left of < leaves first and last as they are.
      first = near > first ? near : first;
      last = far < last ? far : last;
    }
    // Infinite ends become NaN here, and the interval empty, as it should be.
    return {Earlier(first), Later(last)};
  }

  // The t at which the ray crosses the plane where coordinate `axis` is `position`, rounded. Infinite or NaN where the
  // ray runs along the plane.
  double Crossing(int axis, double position) const { return (position - origin_[axis]) * inverse_[axis]; }

  // Lower and upper bounds of the exact t that Crossing rounded.
  static double Earlier(double t) { return t - kSlabRounding * std::abs(t); }
  static double Later(double t) { return t + kSlabRounding * std::abs(t); }

  bool IsNegative(int axis) const { return negative_[axis]; }
  bool IsParallel(int axis) const { return std::isinf(inverse_[axis]); }
  double origin(int axis) const { return origin_[axis]; }

 private:
  static constexpr double kLatest = 0x1p1000;

  Vec3d origin_, inverse_;
  bool negative_[3];
  double first_, last_;
};

}  // namespace deltaray

#endif  // SERVER_GEOMETRY_BOX_TEST_H_
