#include "server/geometry/clip_triangle.h"

#include <cmath>
#include <limits>
#include <vector>

#include "gtest/gtest.h"
#include "tests/oracle/rational_hit.h"
#include "tests/scenes/random.h"

namespace deltaray {
namespace {

using RationalPolygon = std::vector<Vec3r>;

void ClipExactly(RationalPolygon* polygon, int axis, const Rational& position, int side) {
  RationalPolygon kept;
  const auto distance = [&](const Vec3r& p) { return Rational(side * (p[axis] - position)); };
  for (size_t i = 0; i < polygon->size(); ++i) {
    const Vec3r &a = (*polygon)[i], &b = (*polygon)[(i + 1) % polygon->size()];
    const Rational da = distance(a), db = distance(b);
    if (da <= 0) kept.push_back(a);
    if ((da < 0 && db > 0) || (da > 0 && db < 0)) kept.push_back(a + Rational(da / (da - db)) * (b - a));
  }
  *polygon = kept;
}

RationalPolygon ExactPart(const Triangle& triangle, const Bounds& box) {
  RationalPolygon polygon = {ToRational(triangle.v0), ToRational(triangle.v1), ToRational(triangle.v2)};
  for (int axis = 0; axis < 3; ++axis) {
    if (!std::isinf(box.min[axis])) ClipExactly(&polygon, axis, ToRational(box.min[axis]), -1);
    if (!std::isinf(box.max[axis])) ClipExactly(&polygon, axis, ToRational(box.max[axis]), 1);
  }
  return polygon;
}

float StepsDown(float x, int steps) {
  for (int i = 0; i < steps; ++i) x = std::nextafter(x, -Bounds::kInfinity);
  return x;
}

// Whether `found` holds all of the exact part of `triangle` in `box`, and, but for two steps of float32, exceeds it by
// at most `rounding` times the largest coordinate. Returns whether there is a part.
bool CheckPart(const Triangle& triangle, const Bounds& box, const Bounds& found, double rounding) {
  const RationalPolygon part = ExactPart(triangle, box);
  const Bounds whole = triangle.GetBounds();
  if (!found.IsEmpty()) {
    EXPECT_TRUE(box.Contains(found));
    EXPECT_TRUE(whole.Contains(found));
  }
  if (part.empty()) return false;
  EXPECT_FALSE(found.IsEmpty());
  if (found.IsEmpty()) return true;
  for (int axis = 0; axis < 3; ++axis) {
    Rational least = part[0][axis], greatest = part[0][axis];
    for (const Vec3r& corner : part) {
      least = std::min(least, corner[axis]);
      greatest = std::max(greatest, corner[axis]);
    }
    EXPECT_TRUE(ToRational(found.min[axis]) <= least);
    EXPECT_TRUE(ToRational(found.max[axis]) >= greatest);
    const Rational slack =
        ToRational(rounding) * ToRational(std::max(std::abs(whole.min[axis]), std::abs(whole.max[axis])));
    EXPECT_TRUE(-ToRational(StepsDown(-found.min[axis], 2)) >= least - slack) << axis;
    EXPECT_TRUE(ToRational(StepsDown(found.max[axis], 2)) <= greatest + slack) << axis;
  }
  return true;
}

struct Case {
  Triangle triangle;
  Bounds box;
};

Vec3f OnGrid(Random& random, float unit) {
  const auto one = [&] { return static_cast<float>(static_cast<int>(random.Below(7)) - 3) * unit; };
  const float x = one(), y = one(), z = one();
  return {x, y, z};
}

Case RandomCase(Random& random, int kind) {
  Case c;
  const auto place = [&]() -> Vec3f {
    switch (kind) {
      case 0:
        return static_cast<Vec3f>(2.0 * random.InUnitBox() - Vec3d{1, 1, 1});
      case 1:
        return OnGrid(random, 1);
      case 2:
        return OnGrid(random, 0x1p-149f);
      case 3:
        return OnGrid(random, 0x1p126f);
      case 4: {  // far from zero
        const Vec3d p = random.InUnitBox() + Vec3d{1e6, -1e6, 1e3};
        return static_cast<Vec3f>(p);
      }
      default: {  // a sliver nearly along a face
        const Vec3d p = random.InUnitBox();
        return static_cast<Vec3f>(Vec3d{p.x, p.y * random.LogUniform(1e-12, 1e-6), 0.5 + p.z * 1e-7});
      }
    }
  };
  c.triangle = {place(), place(), place()};
  c.box.Extend(place());
  c.box.Extend(place());
  if (random.Below(4) == 0) c.box.max[static_cast<int>(random.Below(3))] = Bounds::kInfinity;
  return c;
}

// Where a face is nearly parallel to the triangle, rounding across the face moves the cut as far as the triangle goes.
double RoundingOf(int kind) { return kind == 5 ? 1 : 0x1p-45; }

TEST(ClipTriangleTest, HoldsTheExactPart) {
  int parts = 0;
  for (int kind = 0; kind < 6; ++kind) {
    Random random(31);
    for (int i = 0; i < 500 && !HasFailure(); ++i) {
      SCOPED_TRACE(testing::Message() << "kind " << kind << ", case " << i);
      const auto [triangle, box] = RandomCase(random, kind);
      parts += CheckPart(triangle, box, ClipTriangle(triangle, box), RoundingOf(kind));
    }
  }
  EXPECT_GT(parts, 1000);
}

TEST(ClipTriangleTest, SplitHoldsTheExactParts) {
  int parts = 0;
  for (int kind = 0; kind < 6; ++kind) {
    Random random(32);
    for (int i = 0; i < 400 && !HasFailure(); ++i) {
      SCOPED_TRACE(testing::Message() << "kind " << kind << ", case " << i);
      const auto [triangle, box] = RandomCase(random, kind);
      const int axis = static_cast<int>(random.Below(3));
      const float position = RandomCase(random, kind).triangle.v0[axis];
      Bounds left, right;
      SplitTriangle(triangle, axis, position, box, &left, &right);
      Bounds left_box = box, right_box = box;
      left_box.max[axis] = std::min(box.max[axis], position);
      right_box.min[axis] = std::max(box.min[axis], position);
      parts += CheckPart(triangle, left_box, left, RoundingOf(kind)) +
               CheckPart(triangle, right_box, right, RoundingOf(kind));
    }
  }
  EXPECT_GT(parts, 1000);
}

TEST(ClipTriangleTest, CutsTheCornersOff) {
  // The diagonal of the unit square: its part within [0, 0.5] in x has y in [0.5, 1] on the diagonal's side.
  const Triangle triangle{{0, 1, 0}, {1, 0, 0}, {1, 1, 0}};
  const Bounds part = ClipTriangle(triangle, {{0, 0, 0}, {0.5f, 1, 0}});
  EXPECT_FLOAT_EQ(part.min.y, 0.5f);
  EXPECT_LE(part.min.y, 0.5f);
  EXPECT_EQ(part.max, (Vec3f{0.5f, 1, 0}));
}

TEST(ClipTriangleTest, FlatTrianglesStayFlat) {
  const Triangle triangle{{0, 0, 0.1f}, {1, 0, 0.1f}, {0, 1, 0.1f}};
  const Bounds part = ClipTriangle(triangle, {{0.3f, 0.3f, 0}, {0.4f, 0.4f, 1}});
  EXPECT_EQ(part.min.z, 0.1f);
  EXPECT_EQ(part.max.z, 0.1f);
}

TEST(ClipTriangleTest, NothingInCommonIsEmpty) {
  const Triangle triangle{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  EXPECT_TRUE(ClipTriangle(triangle, {{0, 0, 1}, {1, 1, 2}}).IsEmpty());
  // Inside the triangle's box, beyond its long edge.
  EXPECT_TRUE(ClipTriangle(triangle, {{0.9f, 0.9f, 0}, {1, 1, 0}}).IsEmpty());
  EXPECT_TRUE(ClipTriangle(triangle, Bounds()).IsEmpty());
}

TEST(ClipTriangleTest, APlaneThroughAFlatTriangleKeepsItOnBothSides) {
  const Triangle triangle{{0, 0, 5}, {1, 0, 5}, {0, 1, 5}};
  Bounds left, right;
  SplitTriangle(triangle, 2, 5, triangle.GetBounds(), &left, &right);
  EXPECT_EQ(left, triangle.GetBounds());
  EXPECT_EQ(right, triangle.GetBounds());
}

}  // namespace
}  // namespace deltaray
