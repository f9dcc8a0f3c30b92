#include "server/mesh/orientation.h"

#include <gtest/gtest.h>

#include <boost/multiprecision/cpp_int.hpp>
#include <cmath>
#include <random>

namespace deltaray {
namespace {

using Integer = boost::multiprecision::cpp_int;

// The rational number that `value` is, times 2^149.
Integer Exact(float value) {
  int exponent;
  const float mantissa = std::frexp(value, &exponent);
  const Integer integer = static_cast<int64_t>(std::ldexp(mantissa, 24));
  const int shift = exponent - 24 + 149;
  return shift >= 0 ? Integer(integer << shift) : Integer(integer / (Integer(1) << -shift));
}

int Reference(Point2 a, Point2 b, Point2 c) {
  const Integer left = (Exact(a.x) - Exact(c.x)) * (Exact(b.y) - Exact(c.y));
  const Integer right = (Exact(a.y) - Exact(c.y)) * (Exact(b.x) - Exact(c.x));
  return left > right ? 1 : left < right ? -1 : 0;
}

TEST(OrientationTest, SmallCases) {
  EXPECT_EQ(Orientation({0, 0}, {1, 0}, {0, 1}), 1);
  EXPECT_EQ(Orientation({0, 0}, {0, 1}, {1, 0}), -1);
  EXPECT_EQ(Orientation({0, 0}, {1, 1}, {3, 3}), 0);
  EXPECT_EQ(Orientation({2, 2}, {2, 2}, {5, 1}), 0);
}

TEST(OrientationTest, AgreesWithIntegersOnPointsNearALine) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> unit(-1, 1);
  int signs[3] = {};
  for (int round = 0; round < 100000; ++round) {
    const float scale = std::ldexp(1.0f, static_cast<int>(random() % 250) - 140);
    const Point2 a{unit(random) * scale, unit(random) * scale}, b{unit(random) * scale, unit(random) * scale};
    const float t = unit(random) * 2;
    Point2 c{a.x + t * (b.x - a.x), a.y + t * (b.y - a.y)};
    if (round % 2) c.x = std::nextafter(c.x, 0.0f);
    const int sign = Orientation(a, b, c);
    ASSERT_EQ(sign, Reference(a, b, c)) << a.x << " " << a.y << " " << b.x << " " << b.y << " " << c.x << " " << c.y;
    ++signs[sign + 1];
  }
  EXPECT_GT(signs[0], 1000);
  EXPECT_GT(signs[2], 1000);
}

TEST(OrientationTest, SeesPointsOnALine) {
  std::mt19937 random(3);
  for (int round = 0; round < 10000; ++round) {
    const auto any = [&] { return static_cast<float>(random() % 2000) - 1000; };
    const Point2 a{any(), any()}, step{any(), any()};
    const float i = random() % 100, j = random() % 100;
    const Point2 b{a.x + i * step.x, a.y + i * step.y}, c{a.x + j * step.x, a.y + j * step.y};
    ASSERT_EQ(Orientation(a, b, c), 0);
    const float huge = 0x1p90f;
    ASSERT_EQ(Orientation({a.x * huge, a.y * huge}, {b.x * huge, b.y * huge}, {c.x * huge, c.y * huge}), 0);
  }
}

TEST(OrientationTest, AgreesWithIntegersAcrossMagnitudes) {
  std::mt19937 random(2);
  const auto any = [&] {
    const float sign = random() % 2 ? 1 : -1;
    return sign * std::ldexp(1.0f + random() % 8, static_cast<int>(random() % 270) - 149);
  };
  for (int round = 0; round < 100000; ++round) {
    const Point2 a{any(), any()}, b{any(), any()};
    const Point2 c = round % 3 ? Point2{any(), any()} : Point2{a.x, b.y};
    ASSERT_EQ(Orientation(a, b, c), Reference(a, b, c));
  }
}

}  // namespace
}  // namespace deltaray
