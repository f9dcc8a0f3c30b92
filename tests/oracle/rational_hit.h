// What hits what, worked out in rational numbers and by another way than the code under test: the point where the ray
// meets the triangle's plane, and its areas in a projection.

#ifndef TESTS_ORACLE_RATIONAL_HIT_H_
#define TESTS_ORACLE_RATIONAL_HIT_H_

#include <boost/multiprecision/cpp_int.hpp>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>

#include "server/geometry/ray.h"
#include "server/geometry/triangles.h"
#include "tests/oracle/products.h"

namespace deltaray {

using Rational = boost::multiprecision::cpp_rational;
using Vec3r = Vec3<Rational>;

// REQUIRES: `x` is finite.
inline Rational ToRational(double x) {
  int exponent;
  const auto mantissa = static_cast<int64_t>(std::ldexp(std::frexp(x, &exponent), 53));
  exponent -= 53;
  const boost::multiprecision::cpp_int power = boost::multiprecision::cpp_int(1) << std::abs(exponent);
  return exponent < 0 ? Rational(mantissa, power) : Rational(mantissa * power);
}

inline Vec3r ToRational(Vec3f a) { return {ToRational(a.x), ToRational(a.y), ToRational(a.z)}; }

struct RationalHit {
  Rational t, u, v;
  bool back;
};

inline std::optional<RationalHit> FindRationalHit(const Ray& ray, const Triangle& triangle) {
  const Vec3r o = ToRational(ray.origin), d = ToRational(ray.direction), v0 = ToRational(triangle.v0);
  const Vec3r e1 = ToRational(triangle.v1) - v0, e2 = ToRational(triangle.v2) - v0;
  const Vec3r normal = CrossProduct(e1, e2);
  const Rational speed = DotProduct(normal, d);
  if (speed == 0) return std::nullopt;
  RationalHit hit;
  // Corners in counter-clockwise order are seen from where the normal points.
  hit.back = speed > 0;
  hit.t = DotProduct(normal, v0 - o) / speed;
  const Vec3r point = o + hit.t * d - v0;
  const int axis = normal.x != 0 ? 0 : normal.y != 0 ? 1 : 2;
  const int a = (axis + 1) % 3, b = (axis + 2) % 3;
  hit.u = (point[a] * e2[b] - point[b] * e2[a]) / normal[axis];
  hit.v = (e1[a] * point[b] - e1[b] * point[a]) / normal[axis];
  if (hit.u < 0 || hit.v < 0 || hit.u + hit.v > 1) return std::nullopt;
  if (std::isinf(ray.t_min) ? ray.t_min > 0 : hit.t < ToRational(ray.t_min)) return std::nullopt;
  if (std::isinf(ray.t_max) ? ray.t_max < 0 : hit.t > ToRational(ray.t_max)) return std::nullopt;
  return hit;
}

// Whether `rounded` is `exact` rounded to nearest even.
inline bool IsNearestEven(float rounded, const Rational& exact) {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  if (std::isnan(rounded) || (rounded == 0 && std::signbit(rounded))) return false;
  if (rounded < 0) return IsNearestEven(-rounded, -exact);
  const Rational overflow = ToRational(0x1p128 - 0x1p103);  // half a step beyond the greatest float
  if (std::isinf(rounded)) return exact >= overflow;
  int exponent;
  std::frexp(rounded, &exponent);
  const bool is_even = std::fmod(std::ldexp(static_cast<double>(rounded), -std::max(exponent - 24, -149)), 2) == 0;
  const float next = std::nextafter(rounded, kInfinity), previous = std::nextafter(rounded, -kInfinity);
  const Rational upper = std::isinf(next) ? overflow : (ToRational(rounded) + ToRational(next)) / 2;
  const Rational lower = (ToRational(rounded) + ToRational(previous)) / 2;
  return is_even ? lower <= exact && exact <= upper && !std::isinf(rounded) : lower < exact && exact < upper;
}

}  // namespace deltaray

#endif  // TESTS_ORACLE_RATIONAL_HIT_H_
