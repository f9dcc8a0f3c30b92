#include "server/geometry/box_test.h"

#include <limits>
#include <optional>
#include <utility>

#include "gtest/gtest.h"
#include "tests/oracle/rational_hit.h"
#include "tests/scenes/random.h"

namespace deltaray {
namespace {

constexpr float kInf = std::numeric_limits<float>::infinity();
constexpr double kNoLimit = std::numeric_limits<double>::infinity();

// The exact interval of t in which the ray's line is in the box and in [t_min, t_max]; first > last where there is
// none, and nullopt where a direction component of 0 says so.
std::optional<std::pair<Rational, Rational>> ExactInterval(const Ray& ray, const Bounds& box) {
  const Rational beyond = ToRational(0x1p900);
  const auto end = [&](float t) { return std::isinf(t) ? (t > 0 ? beyond : Rational(-beyond)) : ToRational(t); };
  Rational first = end(ray.t_min), last = end(ray.t_max);
  for (int axis = 0; axis < 3; ++axis) {
    const Rational o = ToRational(ray.origin[axis]), d = ToRational(ray.direction[axis]);
    const Rational low = ToRational(box.min[axis]), high = ToRational(box.max[axis]);
    if (d == 0) {
      if (o < low || o > high) return std::nullopt;
      continue;
    }
    Rational near = (low - o) / d, far = (high - o) / d;
    if (near > far) std::swap(near, far);
    if (near > first) first = near;
    if (far < last) last = far;
  }
  return std::pair(first, last);
}

// Conservative, and no wider than by rounding. Returns whether the box is hit.
bool Check(const Ray& ray, const Bounds& box) {
  const auto exact = ExactInterval(ray, box);
  const Interval found = BoxTest(ray)(box, kNoLimit);
  if (!exact.has_value()) {
    EXPECT_TRUE(found.IsEmpty());
    return false;
  }
  const auto& [first, last] = *exact;
  const Rational slack = ToRational(0x1p-47) * (abs(first) + abs(last));
  if (first > last + slack) {
    EXPECT_TRUE(found.IsEmpty());
  } else if (first <= last) {
    EXPECT_FALSE(found.IsEmpty());
    if (found.IsEmpty()) return true;
    EXPECT_TRUE(ToRational(found.first) <= first);
    EXPECT_TRUE(ToRational(found.last) >= last);
    // The ends of an infinite t range stand at 2^900 above and are cut off elsewhere in the test.
    const Rational finite = ToRational(0x1p300), rounding = ToRational(0x1p-47);
    EXPECT_TRUE(abs(first) > finite || ToRational(found.first) >= first - rounding * abs(first));
    EXPECT_TRUE(abs(last) > finite || ToRational(found.last) <= last + rounding * abs(last));
  }
  return first <= last;
}

Bounds BoxOf(Vec3f a, Vec3f b) {
  Bounds box;
  box.Extend(a);
  box.Extend(b);
  return box;
}

Vec3f OnGrid(Random& random, float unit) {
  const auto one = [&] { return static_cast<float>(static_cast<int>(random.Below(5)) - 2) * unit; };
  const float x = one(), y = one(), z = one();
  return {x, y, z};
}

TEST(BoxTestTest, AgreesWithRationalsOnGrids) {
  int hits = 0;
  for (const float unit : {1.0f, 0.1f, 0x1p-149f, 0x1p126f}) {
    Random random(21);
    for (int i = 0; i < 1000 && !HasFailure(); ++i) {
      SCOPED_TRACE(testing::Message() << "unit " << unit << ", case " << i);
      const Bounds box = BoxOf(OnGrid(random, unit), OnGrid(random, unit));  // many are flat
      Ray ray{.origin = OnGrid(random, unit), .direction = OnGrid(random, i % 2 == 0 ? 1 : unit)};
      if (i % 5 == 0) ray.direction = -1.0f * ray.direction;  // makes -0 of 0
      if (i % 3 == 0) ray.t_min = -kInf;
      if (i % 7 == 0) ray.t_min = ray.t_max = 1;
      hits += Check(ray, box);
    }
  }
  EXPECT_GT(hits, 300);
}

TEST(BoxTestTest, AgreesWithRationalsAtCorners) {
  Random random(22);
  int hits = 0;
  for (int i = 0; i < 2000 && !HasFailure(); ++i) {
    SCOPED_TRACE(i);
    const double size = random.LogUniform(1e-20, 1e20);
    const auto in_box = [&](double scale) {
      return static_cast<Vec3f>(scale * (2.0 * random.InUnitBox() - Vec3d{1, 1, 1}));
    };
    const Bounds box = BoxOf(in_box(size), in_box(size));
    const Vec3f origin = in_box(size * random.LogUniform(1, 1e6));
    Vec3d aim;
    for (int axis = 0; axis < 3; ++axis) aim[axis] = random.Below(2) == 0 ? box.min[axis] : box.max[axis];
    const auto length = static_cast<float>(random.LogUniform(1e-10, 1e10));
    hits += Check({.origin = origin, .direction = length * static_cast<Vec3f>(aim - static_cast<Vec3d>(origin))}, box);
  }
  EXPECT_GT(hits, 100);
}

TEST(BoxTestTest, LimitEndsTheIntervalInclusively) {
  const BoxTest test({.origin = {0, 0, 0}, .direction = {0, 0, 1}});
  const Bounds box = BoxOf({-1, -1, 2}, {1, 1, 3});
  EXPECT_FALSE(test(box, 2).IsEmpty());
  EXPECT_TRUE(test(box, 1.999).IsEmpty());
  EXPECT_TRUE(test(box, -kNoLimit).IsEmpty());
  EXPECT_LT(test(box, 2.5).last, 2.6);
}

TEST(BoxTestTest, EmptyBoxIsNotHit) {
  EXPECT_TRUE(BoxTest({.origin = {0, 0, 0}, .direction = {0, 0, 1}})(Bounds(), kNoLimit).IsEmpty());
  EXPECT_TRUE(BoxTest({.origin = {0, 0, 0}, .direction = {1, -2, 3}})(Bounds(), kNoLimit).IsEmpty());
}

TEST(BoxTestTest, BoxBesideAnAxisParallelRayIsNotHitWithoutEnd) {
  const Bounds box = BoxOf({1, 1, 1}, {2, 2, 2});
  for (const float zero : {0.0f, -0.0f}) {
    const BoxTest test({.origin = {0, 1, 1}, .t_min = -kInf, .direction = {zero, zero, 1}});
    EXPECT_TRUE(test(box, kNoLimit).IsEmpty());
    const BoxTest in_edge({.origin = {1, 2, 0}, .t_min = -kInf, .direction = {zero, zero, 1}});
    EXPECT_FALSE(in_edge(box, kNoLimit).IsEmpty());
  }
}

TEST(BoxTestTest, IntervalsAtInfinityHoldNothing) {
  const Bounds box = BoxOf({-1, -1, -1}, {1, 1, 1});
  EXPECT_TRUE(BoxTest({.origin = {0, 0, 0}, .t_min = kInf, .direction = {0, 0, 1}})(box, kNoLimit).IsEmpty());
  EXPECT_TRUE(
      BoxTest({.origin = {0, 0, 0}, .t_min = -kInf, .direction = {0, 0, 1}, .t_max = -kInf})(box, kNoLimit).IsEmpty());
}

}  // namespace
}  // namespace deltaray
