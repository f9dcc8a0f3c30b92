#include "server/geometry/exact_triangle.h"

#include <bit>
#include <boost/multiprecision/cpp_int.hpp>
#include <cmath>
#include <cstdint>
#include <initializer_list>

namespace deltaray {
namespace {

namespace mp = boost::multiprecision;

// A float32 is an integer of at most 277 bits times 2^-149, so that a difference has 278, det 836, T 837; the widest
// value, T of one triangle times det of another, shifted by at most 276, has 1949. In place: no allocation.
using Integer = mp::number<mp::cpp_int_backend<2048, 2048, mp::signed_magnitude, mp::unchecked, void>,
                           mp::expression_template_option::et_off>;

// A finite float as mantissa * 2^exponent, the mantissa odd or 0.
struct Parts {
  int32_t mantissa;
  int exponent;

  explicit Parts(float x) {
    const float fraction = std::frexp(x, &exponent);
    mantissa = static_cast<int32_t>(std::ldexp(fraction, 24));
    exponent -= 24;
    if (mantissa == 0) return;
    const int zeros = std::countr_zero(static_cast<uint32_t>(mantissa));
    mantissa /= int32_t{1} << zeros;
    exponent += zeros;
  }
};

// The exponent of the power of two of which all coordinates are multiples; 0 where all are 0.
int CommonExponent(std::initializer_list<Vec3f> points) {
  int least = 128;
  for (const Vec3f& point : points) {
    for (int axis = 0; axis < 3; ++axis) {
      const Parts parts(point[axis]);
      if (parts.mantissa != 0) least = std::min(least, parts.exponent);
    }
  }
  return least == 128 ? 0 : least;
}

Integer Scaled(float x, int exponent) {
  const Parts parts(x);
  if (parts.mantissa == 0) return 0;
  return Integer(parts.mantissa) << (parts.exponent - exponent);
}

Vec3<Integer> Scaled(Vec3f a, int exponent) {
  return {Scaled(a.x, exponent), Scaled(a.y, exponent), Scaled(a.z, exponent)};
}

// The quantities of [Möller and Trumbore 1997] as integers: t = T / det * 2^t_exponent, u = U / det, v = V / det.
// det >= 0: where it was negative, all signs are turned.
struct Exact {
  Integer det, t, u, v;
  int t_exponent;
  bool back;

  Exact(const Ray& ray, const Triangle& triangle) {
    const int position_exponent = CommonExponent({triangle.v0, triangle.v1, triangle.v2, ray.origin});
    const int direction_exponent = CommonExponent({ray.direction});
    t_exponent = position_exponent - direction_exponent;
    const auto v0 = Scaled(triangle.v0, position_exponent);
    const auto e1 = Scaled(triangle.v1, position_exponent) - v0;
    const auto e2 = Scaled(triangle.v2, position_exponent) - v0;
    const auto s = Scaled(ray.origin, position_exponent) - v0;
    const auto d = Scaled(ray.direction, direction_exponent);
    const auto p = Cross(d, e2), q = Cross(s, e1);
    det = Dot(e1, p);
    t = Dot(e2, q);
    u = Dot(s, p);
    v = Dot(d, q);
    back = det < 0;
    if (back) {
      det = -det;
      t = -t;
      u = -u;
      v = -v;
    }
  }

  // The sign of t - end. REQUIRES: det > 0, `end` finite.
  int CompareT(float end) const {
    const Parts parts(end);
    return Compare(t, t_exponent, det * parts.mantissa, parts.exponent);
  }

  // The sign of a * 2^a_exponent - b * 2^b_exponent.
  static int Compare(Integer a, int a_exponent, Integer b, int b_exponent) {
    const int signs = (a > 0) - (a < 0) - ((b > 0) - (b < 0));
    if (signs != 0 || a.is_zero()) return signs;
    // Only one side is shifted, and by no more than the other one's exponent is greater.
    if (a_exponent > b_exponent) {
      a <<= a_exponent - b_exponent;
    } else {
      b <<= b_exponent - a_exponent;
    }
    return (a > b) - (a < b);
  }
};

// Whether both triangles lie in one plane of constant x, y or z, as floors and the bottoms of what stands on them do:
// there a ray meets both at the same t.
bool ShareAxisParallelPlane(const Triangle& a, const Triangle& b) {
  for (int axis = 0; axis < 3; ++axis) {
    const float plane = a.v0[axis];
    if (a.v1[axis] == plane && a.v2[axis] == plane && b.v0[axis] == plane && b.v1[axis] == plane &&
        b.v2[axis] == plane) {
      return true;
    }
  }
  return false;
}

// A quotient of magnitude `bits` * 2^exponent, bits in [2^61, 2^63) or 0. The last bit is also set where more follow,
// so that rounding to at most 60 bits goes as for the exact quotient.
struct RoundedToOdd {
  uint64_t bits = 0;
  int exponent = 0;
  bool negative = false;

  // numerator / denominator * 2^scale. REQUIRES: denominator > 0.
  RoundedToOdd(Integer numerator, Integer denominator, int scale) {
    if (numerator.is_zero()) return;
    negative = numerator < 0;
    if (negative) numerator = -numerator;
    const int shift = 62 - (static_cast<int>(mp::msb(numerator)) - static_cast<int>(mp::msb(denominator)));
    if (shift > 0) {
      numerator <<= shift;
    } else {
      denominator <<= -shift;
    }
    Integer quotient, remainder;
    mp::divide_qr(numerator, denominator, quotient, remainder);
    bits = static_cast<uint64_t>(quotient) | !remainder.is_zero();
    exponent = scale - shift;
  }

  double ToDouble() const {
    return std::ldexp(negative ? -static_cast<double>(bits) : static_cast<double>(bits), exponent);
  }

  // To nearest even, never -0.
  float ToFloat() const {
    if (bits == 0) return 0;
    // The exponent of the last place of a float of this size, subnormal ones included.
    const int last_place = std::max(static_cast<int>(std::bit_width(bits)) - 24 + exponent, -149);
    const int dropped = last_place - exponent;
    if (dropped > 63) return 0;
    const uint64_t half = uint64_t{1} << (dropped - 1), rest = bits & (2 * half - 1);
    uint64_t kept = bits >> dropped;
    if (rest > half || (rest == half && kept % 2 == 1)) ++kept;
    const float magnitude = std::ldexp(static_cast<float>(kept), last_place);
    return negative ? 0 - magnitude : magnitude;
  }
};

thread_local uint64_t exact_decisions = 0;

}  // namespace

uint64_t ExactDecisions() { return exact_decisions; }

bool ExactIsDegenerate(const Triangle& triangle) {
  ++exact_decisions;
  const int exponent = CommonExponent({triangle.v0, triangle.v1, triangle.v2});
  const auto v0 = Scaled(triangle.v0, exponent);
  return Cross(Scaled(triangle.v1, exponent) - v0, Scaled(triangle.v2, exponent) - v0) == Vec3<Integer>{0, 0, 0};
}

bool ExactTestTriangle(const Ray& ray, const Triangle& triangle, Culling culling, Candidate* candidate) {
  ++exact_decisions;
  const Exact exact(ray, triangle);
  if (exact.det == 0) return false;
  if (culling == (exact.back ? Culling::kBack : Culling::kFront)) return false;
  if (exact.u < 0 || exact.v < 0 || exact.u + exact.v > exact.det) return false;
  if (std::isinf(ray.t_min) ? ray.t_min > 0 : exact.CompareT(ray.t_min) < 0) return false;
  if (std::isinf(ray.t_max) ? ray.t_max < 0 : exact.CompareT(ray.t_max) > 0) return false;

  // The quotients' own rounding, and that of adding the error.
  constexpr double kError = 0x1p-50;
  candidate->t = RoundedToOdd(exact.t, exact.det, exact.t_exponent).ToDouble();
  candidate->u = RoundedToOdd(exact.u, exact.det, 0).ToDouble();
  candidate->v = RoundedToOdd(exact.v, exact.det, 0).ToDouble();
  candidate->t_error = kError * std::abs(candidate->t);
  candidate->u_error = kError * candidate->u;
  candidate->v_error = kError * candidate->v;
  candidate->back = exact.back;
  return true;
}

int ExactCompareT(const Ray& ray, const Triangle& a, const Triangle& b) {
  // Scenes with many copies of a triangle compare all of them at every hit.
  if (a.v0 == b.v0 && a.v1 == b.v1 && a.v2 == b.v2) return 0;
  if (ShareAxisParallelPlane(a, b)) return 0;
  ++exact_decisions;
  const Exact exact_a(ray, a), exact_b(ray, b);
  return Exact::Compare(exact_a.t * exact_b.det, exact_a.t_exponent, exact_b.t * exact_a.det, exact_b.t_exponent);
}

void ExactRound(const Ray& ray, const Triangle& triangle, float* t, float* u, float* v) {
  ++exact_decisions;
  const Exact exact(ray, triangle);
  *t = RoundedToOdd(exact.t, exact.det, exact.t_exponent).ToFloat();
  *u = RoundedToOdd(exact.u, exact.det, 0).ToFloat();
  *v = RoundedToOdd(exact.v, exact.det, 0).ToFloat();
}

}  // namespace deltaray
