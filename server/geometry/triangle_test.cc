#include "server/geometry/triangle_test.h"

#include <cmath>
#include <utility>

#include "server/geometry/exact_triangle.h"

namespace deltaray {
namespace {

// All values here are sums of products of at most four factors. The error of each is below this times the same sum over
// the factors' magnitudes: its permanent. Derived in README.md; neither overflow nor underflow can happen.
constexpr double kErrorBound = 10 * 0x1p-53;

Vec3d Abs(Vec3d a) { return {std::abs(a.x), std::abs(a.y), std::abs(a.z)}; }

// The permanent of a cross product.
Vec3d CrossPermanent(Vec3d a, Vec3d b) { return {a.y * b.z + a.z * b.y, a.z * b.x + a.x * b.z, a.x * b.y + a.y * b.x}; }

// A value and the bound of its error.
struct Approximate {
  double value, error;

  bool CertainlyPositive() const { return value > error; }
  bool CertainlyNegative() const { return value < -error; }
  bool IsUncertain() const { return std::abs(value) <= error && error != 0; }
};

// The value of numerator / denominator and its error. REQUIRES: the sign of `denominator` is certain.
Approximate Quotient(Approximate numerator, Approximate denominator) {
  const double value = numerator.value / denominator.value;
  const double error =
      (numerator.error + std::abs(value) * denominator.error) / (std::abs(denominator.value) - denominator.error);
  // The first factor covers the roundings of `error`, the second term those of `value`, value - error, value + error.
  return {value, 1.001 * error + 0x1p-51 * std::abs(value)};
}

// Rounds to nearest even where that is the same for all values that `x` may stand for.
bool RoundCertain(double x, double error, float* rounded) {
  const float lower = static_cast<float>(x - error), upper = static_cast<float>(x + error);
  *rounded = lower + 0.0f;  // makes -0 to +0
  return lower == upper;
}

}  // namespace

bool IsDegenerate(const Triangle& triangle) {
  const Vec3d v0 = static_cast<Vec3d>(triangle.v0);
  const Vec3d e1 = static_cast<Vec3d>(triangle.v1) - v0, e2 = static_cast<Vec3d>(triangle.v2) - v0;
  const Vec3d normal = Cross(e1, e2), permanent = CrossPermanent(Abs(e1), Abs(e2));
  for (int axis = 0; axis < 3; ++axis) {
    if (std::abs(normal[axis]) > kErrorBound * permanent[axis]) return false;
  }
  return ExactIsDegenerate(triangle);
}

bool TestTriangle(const Ray& ray, const Triangle& triangle, uint32_t primitive, Culling culling, Candidate* candidate) {
  // The form of [Möller and Trumbore 1997]: t = T / det, u = U / det, v = V / det.
  const Vec3d d = static_cast<Vec3d>(ray.direction), v0 = static_cast<Vec3d>(triangle.v0);
  const Vec3d e1 = static_cast<Vec3d>(triangle.v1) - v0, e2 = static_cast<Vec3d>(triangle.v2) - v0;
  const Vec3d s = static_cast<Vec3d>(ray.origin) - v0;
  const Vec3d p = Cross(d, e2);
  const Vec3d abs_e1 = Abs(e1), abs_s = Abs(s), p_permanent = CrossPermanent(Abs(d), Abs(e2));
  const double det_permanent = Dot(abs_e1, p_permanent), u_permanent = Dot(abs_s, p_permanent);
  const Approximate det{Dot(e1, p), kErrorBound * det_permanent};
  const Approximate u{Dot(s, p), kErrorBound * u_permanent};
  if (det_permanent == 0) return false;  // parallel for certain: every term of det is 0
  // The line meets the triangle where none of det, U, V and det - U - V have opposite signs, and det is not 0.
  bool positive = det.CertainlyPositive(), negative = det.CertainlyNegative();
  if (negative ? culling == Culling::kBack : positive && culling == Culling::kFront) return false;
  positive |= u.CertainlyPositive();
  negative |= u.CertainlyNegative();
  if (positive && negative) return false;

  const Vec3d q = Cross(s, e1), q_permanent = CrossPermanent(abs_s, abs_e1);
  const double v_permanent = Dot(Abs(d), q_permanent);
  const Approximate v{Dot(d, q), kErrorBound * v_permanent};
  const Approximate w{(det.value - u.value) - v.value, kErrorBound * (det_permanent + u_permanent + v_permanent)};
  positive |= v.CertainlyPositive() || w.CertainlyPositive();
  negative |= v.CertainlyNegative() || w.CertainlyNegative();
  if (positive && negative) return false;

  bool certain = !det.IsUncertain() && !u.IsUncertain() && !v.IsUncertain() && !w.IsUncertain();
  const double t_permanent = Dot(Abs(e2), q_permanent);
  const Approximate t{Dot(e2, q), kErrorBound * t_permanent};
  if (!det.IsUncertain()) {
    const double sign = det.value > 0 ? 1 : -1;
    for (const auto& [end, side] : {std::pair(ray.t_min, sign), std::pair(ray.t_max, -sign)}) {
      // How far the hit is within this end, times |det|.
      if (std::isinf(end)) {
        if ((end > 0) == (side * sign > 0)) return false;
        continue;
      }
      const Approximate inside{side * (t.value - end * det.value),
                               kErrorBound * (t_permanent + std::abs(end) * det_permanent)};
      if (inside.CertainlyNegative()) return false;
      certain &= !inside.IsUncertain();
    }
  }
  if (!certain) {
    if (!ExactTestTriangle(ray, triangle, culling, candidate)) return false;
  } else {
    const Approximate t_quotient = Quotient(t, det), u_quotient = Quotient(u, det), v_quotient = Quotient(v, det);
    *candidate = {.t = t_quotient.value,
                  .t_error = t_quotient.error,
                  .u = u_quotient.value,
                  .u_error = u_quotient.error,
                  .v = v_quotient.value,
                  .v_error = v_quotient.error,
                  .back = det.value < 0};
  }
  candidate->primitive = primitive;
  return true;
}

bool Before(const Ray& ray, const TrianglesView& triangles, const Candidate& a, const Candidate& b) {
  if (a.t_upper() < b.t_lower()) return true;
  if (b.t_upper() < a.t_lower()) return false;
  if (a.primitive == b.primitive) return false;
  const int order = ExactCompareT(ray, triangles[a.primitive], triangles[b.primitive]);
  return order != 0 ? order < 0 : a.primitive < b.primitive;
}

Hit Round(const Ray& ray, const TrianglesView& triangles, const Candidate& candidate) {
  Hit hit{.primitive = candidate.primitive, .back = candidate.back};
  if (!RoundCertain(candidate.t, candidate.t_error, &hit.t) || !RoundCertain(candidate.u, candidate.u_error, &hit.u) ||
      !RoundCertain(candidate.v, candidate.v_error, &hit.v)) {
    ExactRound(ray, triangles[candidate.primitive], &hit.t, &hit.u, &hit.v);
  }
  return hit;
}

}  // namespace deltaray
