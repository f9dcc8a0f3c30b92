#include "server/service/triangle_normal.h"

#include <cmath>
#include <random>

#include "boost/multiprecision/cpp_bin_float.hpp"
#include "gtest/gtest.h"

namespace deltaray {
namespace {

using Wide = boost::multiprecision::number<
    boost::multiprecision::cpp_bin_float<1400, boost::multiprecision::digit_base_2, void, int32_t, -100000, 100000>>;

// The largest difference in any component from the normal in 1400 bits.
double Error(const Triangle& triangle) {
  Wide a[3], b[3], n[3];
  for (int i = 0; i < 3; ++i) {
    a[i] = Wide(triangle.v1[i]) - Wide(triangle.v0[i]);
    b[i] = Wide(triangle.v2[i]) - Wide(triangle.v0[i]);
  }
  for (int i = 0; i < 3; ++i) n[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
  const Wide length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
  const Vec3f normal = GeometricNormal(triangle);
  double error = 0;
  for (int i = 0; i < 3; ++i) {
    error = std::max(error, std::abs(static_cast<double>(Wide(normal[i]) - (length == 0 ? Wide(0) : n[i] / length))));
  }
  return error;
}

TEST(TriangleNormalTest, PointsToTheFront) {
  EXPECT_EQ(GeometricNormal({{0, 0, 0}, {2, 0, 0}, {0, 3, 0}}), (Vec3f{0, 0, 1}));
  EXPECT_EQ(GeometricNormal({{0, 0, 0}, {0, 3, 0}, {2, 0, 0}}), (Vec3f{0, 0, -1}));
}

TEST(TriangleNormalTest, IsZeroForATriangleOfZeroArea) {
  EXPECT_EQ(GeometricNormal({{1, 2, 3}, {1, 2, 3}, {4, 5, 6}}), Vec3f());
  EXPECT_EQ(GeometricNormal({{0, 0, 0}, {1, 1, 1}, {3, 3, 3}}), Vec3f());
}

TEST(TriangleNormalTest, NeitherOverflowsNorVanishes) {
  EXPECT_EQ(GeometricNormal({{0, 0, 0}, {3e38f, 0, 0}, {0, 3e38f, 0}}), (Vec3f{0, 0, 1}));
  EXPECT_EQ(GeometricNormal({{-3e38f, -3e38f, 0}, {3e38f, 0, 0}, {0, 3e38f, 0}}), (Vec3f{0, 0, 1}));
  EXPECT_EQ(GeometricNormal({{0, 0, 0}, {1e-45f, 0, 0}, {0, 1e-45f, 0}}), (Vec3f{0, 0, 1}));
}

TEST(TriangleNormalTest, IsWithinItsBoundForTrianglesOfAllShapes) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> unit(-1, 1), exponent(-40, 37), thinness(-30, 0);
  for (int i = 0; i < 1000; ++i) {
    const auto point = [&](double size) {
      return static_cast<Vec3f>(Vec3d{size * unit(random), size * unit(random), size * unit(random)});
    };
    const double size = std::pow(10, exponent(random));
    Triangle triangle{point(size), point(size), point(size)};
    if (i % 2 == 0) {
      // A sliver: the third corner all but on the line through the others.
      const double s = unit(random), d = std::pow(2, thinness(random));
      for (int axis = 0; axis < 3; ++axis) {
        triangle.v2[axis] = static_cast<float>(triangle.v0[axis] + s * (double{triangle.v1[axis]} - triangle.v0[axis]) +
                                               d * size * unit(random));
      }
    }
    ASSERT_LE(Error(triangle), 0x1p-22) << i;
  }
}

TEST(TriangleNormalTest, IsWithinItsBoundWhereDoubleCancels) {
  // The cross product of these edges is exact only in more than 53 bits.
  EXPECT_LE(Error({{0, 0, 0}, {16777215, 16777213, 16777211}, {16777213, 16777211, 16777209}}), 0x1p-22);
  EXPECT_LE(Error({{1e-30f, 0, 1}, {1e30f, 1e30f, 1e30f}, {-1e30f, -1e30f, -1e30f}}), 0x1p-22);
  EXPECT_LE(Error({{1, 1, 1e-20f}, {1e8f, 1e8f, 1}, {1e15f, 1e15f, 1e7f}}), 0x1p-22);
}

}  // namespace
}  // namespace deltaray
