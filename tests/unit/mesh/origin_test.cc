#include "server/mesh/origin.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <boost/multiprecision/cpp_int.hpp>
#include <cmath>
#include <limits>
#include <random>

namespace deltaray {
namespace {

PolygonMesh AllUsed(std::vector<Vec3d> vertices) {
  PolygonMesh mesh;
  mesh.vertices = std::move(vertices);
  for (uint32_t i = 0; i < mesh.vertices.size(); ++i) mesh.corners.push_back(i);
  return mesh;
}

constexpr Vec3d kZero;

TEST(OriginTest, FarMeshesThatFloatHoldsGetAnOriginToo) {
  const PolygonMesh mesh = AllUsed({{500000, 5400000, 0}, {500100, 5400000, 12.25}, {500100, 5400100, 100}});
  const Vec3d origin = ChooseOrigin(mesh);
  EXPECT_EQ(origin, (Vec3d{500096, 5400064, 0}));
  EXPECT_EQ(StorePositions(mesh.vertices, origin).max_rounding, 0);
}

TEST(OriginTest, ZeroWhereFloatWouldNoLongerHoldAVertexThatNoFaceUses) {
  PolygonMesh mesh = AllUsed({{500000, 5400000, 0}, {500100, 5400000, 12.25}, {500100, 5400100, 100}});
  mesh.vertices.push_back({0.1f, 0, 0});
  EXPECT_EQ(ChooseOrigin(mesh), kZero);
}

TEST(OriginTest, ZeroWhereFloatIsExactOnlyThere) {
  // 1e6, 1, 0 would be near the centre; 0.1f - 1 is no float.
  EXPECT_EQ(ChooseOrigin(AllUsed({{1e6, 0.1f, 0}, {1e6 + 1, 1, 0}, {1e6, 0.5, 0.25}})), kZero);
  EXPECT_EQ(ChooseOrigin(AllUsed({{1e6, 0.125, 0}, {1e6 + 1, 1, 0}, {1e6, 0.5, 0.25}})), (Vec3d{1e6, 1, 0}));
}

TEST(OriginTest, ZeroForOrdinaryFilesThatAreNotExact) {
  EXPECT_EQ(ChooseOrigin(AllUsed({{0.1, 0.2, 0.3}, {1.1, 1.2, 1.3}})), kZero);
  EXPECT_EQ(ChooseOrigin(AllUsed({{15.1, 0, 0}, {16.0, 0, 0}, {15, 0.1, 0}, {15, 1, 0}})), kZero);
}

TEST(OriginTest, ZeroWithoutExtentOrVertices) {
  EXPECT_EQ(ChooseOrigin(PolygonMesh()), kZero);
  EXPECT_EQ(ChooseOrigin(AllUsed({{1e6 + 0.1, 0, 0}, {1e6 + 0.1, 0, 0}})), kZero);
}

TEST(OriginTest, FarMeshesGetACoarseOrigin) {
  // The extent is 100.3, so that coordinates are multiples of 128; z is near zero and stays.
  const Vec3d origin = ChooseOrigin(AllUsed({{500000.1, 5400000.1, 12.3}, {500100.4, 5400050.1, 45.6}}));
  EXPECT_EQ(origin, (Vec3d{500096, 5400064, 0}));
  EXPECT_EQ(ChooseOrigin(AllUsed({{-500000.1, 0, 0}, {-500064.1, 0, 1}})), (Vec3d{-500032, 0, 0}));
}

TEST(OriginTest, VerticesThatNoFaceUsesDoNotCount) {
  PolygonMesh mesh = AllUsed({{500000.1, 0.25, 0}, {500100.4, 0, 0}, {500000.1, 9, 0}});
  const Vec3d origin = ChooseOrigin(mesh);
  EXPECT_NE(origin, kZero);
  mesh.vertices.push_back({0.1, 0, 0});
  EXPECT_EQ(ChooseOrigin(mesh), origin);
}

TEST(OriginTest, ZeroWhereAnUnusedVertexWouldLeaveTheRange) {
  const double far = 3e38;
  PolygonMesh mesh = AllUsed({{far, 0, 0}, {far * (1 - 1e-9), 0, 0}, {far, far * 1e-9, 0}});
  EXPECT_NE(ChooseOrigin(mesh), kZero);
  mesh.vertices.push_back({-far, 0, 0});
  EXPECT_EQ(ChooseOrigin(mesh), kZero);
}

TEST(OriginTest, PositionsAreTheNearestFloats) {
  const StoredPositions stored = StorePositions({{500000.123, -0.0, 1e-46}}, {500000, 0, 0});
  EXPECT_EQ(stored.positions[0], (Vec3f{static_cast<float>(500000.123 - 500000), 0, 0}));
  EXPECT_FALSE(std::signbit(stored.positions[0].y));
}

// The rational number that `value` is, times 2^1074.
boost::multiprecision::cpp_int ExactDouble(double value) {
  int exponent;
  const double mantissa = std::frexp(value, &exponent);
  boost::multiprecision::cpp_int integer = static_cast<int64_t>(std::ldexp(mantissa, 53));
  const int shift = exponent - 53 + 1074;
  return shift >= 0 ? integer << shift : integer / (boost::multiprecision::cpp_int(1) << -shift);
}

TEST(OriginTest, RoundingIsExact) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> mantissa(-2, 2);
  for (int round = 0; round < 20000; ++round) {
    const double given = std::ldexp(mantissa(random), static_cast<int>(random() % 60) - 30);
    const double origin = round % 3 == 0 ? 0 : std::ldexp(mantissa(random), static_cast<int>(random() % 60) - 30);
    const StoredPositions stored = StorePositions({{given, 0, 0}}, {origin, 0, 0});
    const boost::multiprecision::cpp_int exact =
        abs(ExactDouble(origin) + ExactDouble(stored.positions[0].x) - ExactDouble(given));
    const boost::multiprecision::cpp_int reported = ExactDouble(stored.max_rounding);
    EXPECT_LE(boost::multiprecision::cpp_int(abs(exact - reported) << 52), exact)
        << round << " " << given << " " << origin;
  }
}

}  // namespace
}  // namespace deltaray
