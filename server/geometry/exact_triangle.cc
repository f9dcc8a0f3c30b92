#include "server/geometry/exact_triangle.h"

#include <algorithm>
#include <bit>
#include <boost/multiprecision/cpp_int.hpp>
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <type_traits>

#include "server/geometry/fixed_integer.h"

namespace deltaray {
namespace {

namespace mp = boost::multiprecision;

// A float32 is an integer of at most 277 bits times 2^-149, so that a difference has 278, det 836, T 837; the widest
// value, T of one triangle times det of another, has 1673. In place: no allocation.
using Integer = mp::number<mp::cpp_int_backend<2048, 2048, mp::signed_magnitude, mp::unchecked, void>,
                           mp::expression_template_option::et_off>;

// What all but scenes of many magnitudes need.
using Narrow = boost::int128_type;

Integer ToInteger(const Integer& a) { return a; }
Integer ToInteger(Narrow a) { return Integer(a); }
template <int N>
Integer ToInteger(const FixedInteger<N>& a) {
  const FixedInteger<N> magnitude = a.IsNegative() ? -a : a;
  Integer integer;
  static_assert(sizeof(*integer.backend().limbs()) == sizeof(uint64_t));
  integer.backend().resize(N, N);
  std::ranges::copy(magnitude.words(), integer.backend().limbs());
  integer.backend().normalize();
  if (a.IsNegative()) integer.backend().negate();
  return integer;
}

// A finite float as mantissa * 2^exponent, the mantissa odd or 0.
struct Parts {
  int32_t mantissa;
  int exponent;

  explicit Parts(float x) {
    const auto bits = std::bit_cast<uint32_t>(x);
    const uint32_t biased = bits >> 23 & 0xFF, fraction = bits & 0x7F'FFFF;
    uint32_t magnitude = biased == 0 ? fraction : fraction | 0x80'0000;  // subnormal numbers and 0 have no leading one
    exponent = std::max(static_cast<int>(biased), 1) - 150;
    if (magnitude != 0) {
      const int zeros = std::countr_zero(magnitude);
      magnitude >>= zeros;
      exponent += zeros;
    }
    mantissa = std::signbit(x) ? -static_cast<int32_t>(magnitude) : static_cast<int32_t>(magnitude);
  }
};

// What some coordinates have in common: all are multiples of 2^least, and less than 2^end. 0 and 0 where all are 0.
struct Exponents {
  int least = 0, end = 0;

  explicit Exponents(std::initializer_list<Vec3f> points) {
    bool is_first = true;
    for (const Vec3f& point : points) {
      for (int axis = 0; axis < 3; ++axis) {
        const Parts parts(point[axis]);
        if (parts.mantissa == 0) continue;
        const int bits = static_cast<int>(std::bit_width(static_cast<uint32_t>(std::abs(parts.mantissa))));
        least = is_first ? parts.exponent : std::min(least, parts.exponent);
        end = is_first ? parts.exponent + bits : std::max(end, parts.exponent + bits);
        is_first = false;
      }
    }
  }

  int Bits() const { return end - least; }
};

template <typename Int>
Int Scaled(float x, int exponent) {
  const Parts parts(x);
  if (parts.mantissa == 0) return 0;
  if constexpr (std::is_same_v<Int, Narrow>) {
    return Int{parts.mantissa} * (Int{1} << (parts.exponent - exponent));
  } else if constexpr (std::is_same_v<Int, Integer>) {
    return Int(parts.mantissa) << (parts.exponent - exponent);
  } else {
    return Int::Shifted(parts.mantissa, parts.exponent - exponent);
  }
}

template <typename Int>
Vec3<Int> Scaled(Vec3f a, int exponent) {
  return {Scaled<Int>(a.x, exponent), Scaled<Int>(a.y, exponent), Scaled<Int>(a.z, exponent)};
}

// The quantities of [Möller and Trumbore 1997] as integers: t = T / det * 2^t_exponent, u = U / det, v = V / det.
// det >= 0: where it was negative, all signs are turned.
template <typename Int>
struct Quantities {
  Int det, t, u, v;
  bool back;

  Quantities(const Ray& ray, const Triangle& triangle, int position_exponent, int direction_exponent) {
    const auto v0 = Scaled<Int>(triangle.v0, position_exponent);
    const auto e1 = Scaled<Int>(triangle.v1, position_exponent) - v0;
    const auto e2 = Scaled<Int>(triangle.v2, position_exponent) - v0;
    const auto s = Scaled<Int>(ray.origin, position_exponent) - v0;
    const auto d = Scaled<Int>(ray.direction, direction_exponent);
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

  bool IsInside() const { return det != 0 && u >= 0 && v >= 0 && u + v <= det; }
};

// The sign of `a` - 0.
template <typename Int>
int Sign(const Int& a) {
  return (a > 0) - (a < 0);
}

// Calls with(type_identity<Int>), Int the narrowest integers that Quantities can be of where points and direction have
// so many bits.
template <typename With>
auto WithIntegers(const Exponents& position, const Exponents& direction, With&& with) {
  // Of the largest of det, T, U, V and U + V, without its sign; see README.md.
  const int bits = 2 * position.Bits() + std::max(position.Bits(), direction.Bits()) + 6;
  if (bits < 128) return with(std::type_identity<Narrow>());
  if (bits < 256) return with(std::type_identity<FixedInteger<4>>());
  if (bits < 512) return with(std::type_identity<FixedInteger<8>>());
  return with(std::type_identity<Integer>());
}

// Calls with(quantities, t_exponent).
template <typename With>
auto WithQuantities(const Ray& ray, const Triangle& triangle, With&& with) {
  const Exponents position({triangle.v0, triangle.v1, triangle.v2, ray.origin}), direction({ray.direction});
  return WithIntegers(position, direction, [&]<typename Int>(std::type_identity<Int>) {
    return with(Quantities<Int>(ray, triangle, position.least, direction.least), position.least - direction.least);
  });
}

// The sign of T / det * 2^t_exponent - end.
template <typename Int>
int CompareT(const Quantities<Int>& exact, int t_exponent, float end) {
  if (std::isinf(end)) return end > 0 ? -1 : 1;
  const Parts parts(end);
  if (Sign(exact.t) != Sign(parts.mantissa) || parts.mantissa == 0) return Sign(exact.t) - Sign(parts.mantissa);
  Integer a = ToInteger(exact.t), b = ToInteger(exact.det) * parts.mantissa;
  // Only one side is shifted, and by no more than the other one's exponent is greater.
  if (t_exponent > parts.exponent) {
    a <<= t_exponent - parts.exponent;
  } else {
    b <<= parts.exponent - t_exponent;
  }
  return (a > b) - (a < b);
}

// Products of two, without overflow.
Integer Product(const Integer& a, const Integer& b) { return a * b; }
FixedInteger<4> Product(Narrow a, Narrow b) { return FixedInteger<4>(a) * FixedInteger<4>(b); }
template <int N>
FixedInteger<2 * N> Product(const FixedInteger<N>& a, const FixedInteger<N>& b) {
  return FixedInteger<2 * N>(a) * FixedInteger<2 * N>(b);
}

// Whether both have the same corners, in any order. REQUIRES: those of each differ.
bool HaveSameCorners(const Triangle& a, const Triangle& b) {
  const auto is_of_b = [&b](Vec3f corner) { return corner == b.v0 || corner == b.v1 || corner == b.v2; };
  return is_of_b(a.v0) && is_of_b(a.v1) && is_of_b(a.v2);
}

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

// numerator / denominator * 2^scale, within 2^-50 of itself. REQUIRES: denominator > 0.
double Quotient(Narrow numerator, Narrow denominator, int scale) {
  return std::ldexp(static_cast<double>(numerator) / static_cast<double>(denominator), scale);
}
template <int N>
double Quotient(const FixedInteger<N>& numerator, const FixedInteger<N>& denominator, int scale) {
  return std::ldexp(numerator.ToDouble() / denominator.ToDouble(), scale);
}
double Quotient(const Integer& numerator, const Integer& denominator, int scale) {
  return RoundedToOdd(numerator, denominator, scale).ToDouble();
}

thread_local uint64_t exact_decisions = 0;

}  // namespace

uint64_t ExactDecisions() { return exact_decisions; }

bool ExactIsDegenerate(const Triangle& triangle) {
  ++exact_decisions;
  const int exponent = Exponents({triangle.v0, triangle.v1, triangle.v2}).least;
  const auto v0 = Scaled<Integer>(triangle.v0, exponent);
  return Cross(Scaled<Integer>(triangle.v1, exponent) - v0, Scaled<Integer>(triangle.v2, exponent) - v0) ==
         Vec3<Integer>{0, 0, 0};
}

bool ExactTestTriangle(const Ray& ray, const Triangle& triangle, Culling culling, Candidate* candidate) {
  ++exact_decisions;
  return WithQuantities(ray, triangle, [&](const auto& exact, int t_exponent) {
    if (!exact.IsInside()) return false;
    if (culling == (exact.back ? Culling::kBack : Culling::kFront)) return false;
    if (CompareT(exact, t_exponent, ray.t_min) < 0 || CompareT(exact, t_exponent, ray.t_max) > 0) return false;

    // The quotients' own error, and the rounding of adding it.
    constexpr double kError = 0x1p-49;
    candidate->t = Quotient(exact.t, exact.det, t_exponent);
    candidate->u = Quotient(exact.u, exact.det, 0);
    candidate->v = Quotient(exact.v, exact.det, 0);
    candidate->t_error = kError * std::abs(candidate->t);
    candidate->u_error = kError * candidate->u;
    candidate->v_error = kError * candidate->v;
    candidate->back = exact.back;
    return true;
  });
}

int ExactCompareT(const Ray& ray, const Triangle& a, const Triangle& b) {
  // Scenes with many copies of triangles, or with both sides of each, compare them at every hit.
  if (HaveSameCorners(a, b)) return 0;
  if (ShareAxisParallelPlane(a, b)) return 0;
  ++exact_decisions;
  const Exponents position({a.v0, a.v1, a.v2, b.v0, b.v1, b.v2, ray.origin}), direction({ray.direction});
  return WithIntegers(position, direction, [&]<typename Int>(std::type_identity<Int>) {
    const Quantities<Int> of_a(ray, a, position.least, direction.least);
    const Quantities<Int> of_b(ray, b, position.least, direction.least);
    const auto left = Product(of_a.t, of_b.det), right = Product(of_b.t, of_a.det);
    return (left > right) - (left < right);
  });
}

void ExactRound(const Ray& ray, const Triangle& triangle, float* t, float* u, float* v) {
  ++exact_decisions;
  WithQuantities(ray, triangle, [&](const auto& exact, int t_exponent) {
    const Integer det = ToInteger(exact.det);
    *t = RoundedToOdd(ToInteger(exact.t), det, t_exponent).ToFloat();
    *u = RoundedToOdd(ToInteger(exact.u), det, 0).ToFloat();
    *v = RoundedToOdd(ToInteger(exact.v), det, 0).ToFloat();
  });
}

}  // namespace deltaray
