#include "server/geometry/fixed_integer.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "gtest/gtest.h"
#include "tests/scenes/random.h"

namespace deltaray {
namespace {

using Unlimited = boost::multiprecision::cpp_int;

template <int N>
Unlimited ToUnlimited(const FixedInteger<N>& a) {
  Unlimited value = a.IsNegative() ? -1 : 0;
  for (int i = N - 1; i >= 0; --i) value = value * (Unlimited(1) << 64) + a.words()[i];
  return value;
}

// Of any number of bits up to `bits`, and often with long runs of ones or zeros, at which carries go far.
template <int N>
FixedInteger<N> AnyOf(Random& random, int bits) {
  FixedInteger<N> value = 0;
  const int length = static_cast<int>(random.Below(static_cast<uint32_t>(bits) + 1));
  for (int begin = 0; begin < length; begin += 24) {
    const uint32_t kind = random.Below(3), piece = kind == 0 ? 0xFFFFFF : kind == 1 ? 0 : random.Below(1u << 24);
    value = value +
            FixedInteger<N>::Shifted(static_cast<int32_t>(piece & ((1u << std::min(24, length - begin)) - 1)), begin);
  }
  return random.Below(2) == 0 ? value : -value;
}

template <int N>
void CompareWithUnlimited() {
  Random random(N);
  for (int i = 0; i < 20000; ++i) {
    const auto c = AnyOf<N>(random, 32 * N - 2), d = AnyOf<N>(random, 32 * N - 2);
    ASSERT_EQ(ToUnlimited(c * d), ToUnlimited(c) * ToUnlimited(d));
    const auto a = AnyOf<N>(random, 64 * N - 2);
    const auto b = i % 8 == 0 ? a : i % 8 == 1 ? a + 1 : i % 8 == 2 ? -a : AnyOf<N>(random, 64 * N - 2);
    const Unlimited x = ToUnlimited(a), y = ToUnlimited(b);
    ASSERT_EQ(ToUnlimited(a + b), x + y);
    ASSERT_EQ(ToUnlimited(a - b), x - y);
    ASSERT_EQ(ToUnlimited(-a), -x);
    ASSERT_EQ(ToUnlimited(FixedInteger<2 * N>(a)), x);
    ASSERT_EQ(a == b, x == y);
    ASSERT_EQ(a < b, x < y);
    ASSERT_EQ(a > b, x > y);
    ASSERT_EQ(a < 0, x < 0);
    ASSERT_EQ(a > 0, x > 0);
    // What the double stands for, and x, both times the same power of two where the double is no integer.
    const double rounded = a.ToDouble();
    if (x == 0) {
      ASSERT_EQ(rounded, 0);
      continue;
    }
    int exponent;
    const auto mantissa = static_cast<int64_t>(std::ldexp(std::frexp(rounded, &exponent), 53));
    exponent -= 53;
    const Unlimited exact = exponent < 0 ? x << -exponent : x;
    const Unlimited given = exponent < 0 ? Unlimited(mantissa) : Unlimited(mantissa) << exponent;
    ASSERT_LE(Unlimited(abs(given - exact)) << 52, abs(exact)) << rounded;
  }
}

TEST(FixedIntegerTest, AgreesWithIntegersOfAnySize) {
  CompareWithUnlimited<2>();
  CompareWithUnlimited<4>();
  CompareWithUnlimited<8>();
}

TEST(FixedIntegerTest, ShiftsAcrossWords) {
  for (const int32_t value : {0, 1, -1, 0xFFFFFF, -0xFFFFFF, 0x7FFFFFFF, -0x7FFFFFFF}) {
    for (int shift = 0; shift < 4 * 64 - 32; ++shift) {
      ASSERT_EQ(ToUnlimited(FixedInteger<4>::Shifted(value, shift)), Unlimited(value) * (Unlimited(1) << shift))
          << value << " << " << shift;
    }
  }
}

TEST(FixedIntegerTest, TakesAllOfNativeOnes) {
  for (const auto value : {boost::int128_type{0}, boost::int128_type{-1}, boost::int128_type{1} << 126,
                           -(boost::int128_type{1} << 126), (boost::int128_type{1} << 100) - 5}) {
    ASSERT_EQ(ToUnlimited(FixedInteger<4>(value)), Unlimited(value));
  }
}

}  // namespace
}  // namespace deltaray
