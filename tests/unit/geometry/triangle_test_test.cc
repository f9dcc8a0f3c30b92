#include "server/geometry/triangle_test.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "gtest/gtest.h"
#include "tests/oracle/rational_hit.h"
#include "tests/scenes/random.h"

namespace deltaray {
namespace {

constexpr float kInf = std::numeric_limits<float>::infinity();
constexpr float kMax = std::numeric_limits<float>::max();
constexpr float kDenormal = std::numeric_limits<float>::denorm_min();

struct Case {
  Ray ray;
  Triangle triangle;
};

Vec3f ToFloat(Vec3d a) { return static_cast<Vec3f>(a); }

// Coordinates in [-size, size].
Vec3f InBox(Random& random, double size) { return ToFloat(size * (2.0 * random.InUnitBox() - Vec3d{1, 1, 1})); }

// Integers from -3 to 3, times `unit`.
Vec3f OnGrid(Random& random, float unit) {
  const auto one = [&] { return static_cast<float>(static_cast<int>(random.Below(7)) - 3) * unit; };
  const float x = one(), y = one(), z = one();
  return {x, y, z};
}

// Every exponent of float32 is as likely as another; some zeros.
float OfAnySize(Random& random) {
  if (random.Below(8) == 0) return 0;
  const float x = static_cast<float>(random.LogUniform(0x1p-149, 0x1p127));
  return random.Below(2) == 0 ? x : -x;
}
Vec3f AnyVector(Random& random) {
  const float x = OfAnySize(random), y = OfAnySize(random), z = OfAnySize(random);
  return {x, y, z};
}

Triangle InBoxTriangle(Random& random, double size) {
  const Vec3f a = InBox(random, size), b = InBox(random, size), c = InBox(random, size);
  return {a, b, c};
}

// Magnitudes up to 2^spread times each other, of which each exponent is as likely as another.
Vec3f Spread(Random& random, double spread) {
  const auto one = [&] {
    const auto x = static_cast<float>(std::exp2(spread * (random.Uniform() - 0.5)));
    return random.Below(2) == 0 ? x : -x;
  };
  const float x = one(), y = one(), z = one();
  return {x, y, z};
}

// A point of the triangle, rounded: a corner, on an edge or inside, one as likely as another.
Vec3d PointOf(Random& random, const Triangle& triangle) {
  const uint32_t kind = random.Below(3);
  double u = kind == 0 ? random.Below(2) : random.Uniform();
  double v = kind == 0   ? (u == 0 ? random.Below(2) : 0)
             : kind == 1 ? (random.Below(2) == 0 ? 0 : 1 - u)
                         : random.Uniform();
  if (u + v > 1) u = 1 - u, v = 1 - v;
  const Vec3d v0 = static_cast<Vec3d>(triangle.v0);
  return v0 + u * (static_cast<Vec3d>(triangle.v1) - v0) + v * (static_cast<Vec3d>(triangle.v2) - v0);
}

Ray Aimed(Random& random, const Triangle& triangle, Vec3f origin) {
  return {.origin = origin, .direction = ToFloat(PointOf(random, triangle) - static_cast<Vec3d>(origin))};
}

// Each makes a case that is hard in one way. The interval is set later.
struct Family {
  const char* name;
  Case (*make)(Random& random);
};

const Family kFamilies[] = {
    {"ordinary",
     [](Random& random) {
       const Triangle triangle = InBoxTriangle(random, 1);
       return Case{{.origin = InBox(random, 2), .direction = InBox(random, 1)}, triangle};
     }},
    {"aimed",
     [](Random& random) {
       const Triangle triangle = InBoxTriangle(random, 1);
       return Case{Aimed(random, triangle, InBox(random, 10)), triangle};
     }},
    {"grid",
     [](Random& random) {
       const Triangle triangle{OnGrid(random, 1), OnGrid(random, 1), OnGrid(random, 1)};
       return Case{{.origin = OnGrid(random, 1), .direction = OnGrid(random, 1)}, triangle};
     }},
    {"grid of denormals",
     [](Random& random) {
       const Triangle triangle{OnGrid(random, kDenormal), OnGrid(random, kDenormal), OnGrid(random, kDenormal)};
       return Case{{.origin = OnGrid(random, kDenormal), .direction = OnGrid(random, random.Below(2) ? 1 : kDenormal)},
                   triangle};
     }},
    {"grid of giants",
     [](Random& random) {
       const Triangle triangle{OnGrid(random, 0x1p126f), OnGrid(random, 0x1p126f), OnGrid(random, 0x1p126f)};
       return Case{{.origin = OnGrid(random, 0x1p126f), .direction = OnGrid(random, random.Below(2) ? 1 : kDenormal)},
                   triangle};
     }},
    {"coplanar",
     [](Random& random) {
       Triangle triangle = InBoxTriangle(random, 1);
       Ray ray = Aimed(random, triangle, ToFloat(PointOf(random, triangle)));
       if (random.Below(2) == 0) triangle.v0.z = triangle.v1.z = triangle.v2.z = ray.origin.z, ray.direction.z = 0;
       return Case{ray, triangle};
     }},
    {"far origin",
     [](Random& random) {
       const Triangle triangle = InBoxTriangle(random, 1);
       return Case{Aimed(random, triangle, InBox(random, random.LogUniform(1e3, 1e9))), triangle};
     }},
    {"origin on the triangle",
     [](Random& random) {
       const Triangle triangle = InBoxTriangle(random, 1);
       return Case{{.origin = ToFloat(PointOf(random, triangle)), .direction = InBox(random, 1)}, triangle};
     }},
    {"sliver",
     [](Random& random) {
       Triangle triangle = InBoxTriangle(random, 1);
       triangle.v2 = ToFloat(PointOf(random, {triangle.v0, triangle.v1, triangle.v1}) +
                             static_cast<Vec3d>(InBox(random, random.LogUniform(1e-9, 1e-2))));
       return Case{Aimed(random, triangle, InBox(random, 3)), triangle};
     }},
    {"1e30",
     [](Random& random) {
       const Triangle triangle = InBoxTriangle(random, 1e30);
       Ray ray = Aimed(random, triangle, InBox(random, 1e31));
       const auto scale = static_cast<float>(random.LogUniform(1e-35, 1));
       ray.direction = scale * ray.direction;
       return Case{ray, triangle};
     }},
    {"any size",
     [](Random& random) {
       const Triangle triangle{AnyVector(random), AnyVector(random), AnyVector(random)};
       return Case{{.origin = AnyVector(random), .direction = AnyVector(random)}, triangle};
     }},
    // Every size of integers is needed for the exact arithmetic.
    {"spread",
     [](Random& random) {
       const double spread = random.Uniform() * 220;
       const Triangle triangle{Spread(random, spread), Spread(random, spread), Spread(random, spread)};
       return Case{Aimed(random, triangle, Spread(random, spread)), triangle};
     }},
    // Likewise, and the integers are as large as they can be.
    {"one tiny coordinate",
     [](Random& random) {
       const double size = std::exp2(60 * random.Uniform());
       Triangle triangle = InBoxTriangle(random, size);
       triangle.v0[static_cast<int>(random.Below(3))] *= static_cast<float>(std::exp2(-190 * random.Uniform()));
       return Case{Aimed(random, triangle, InBox(random, size)), triangle};
     }},
    {"axis-parallel",
     [](Random& random) {
       const Triangle triangle{OnGrid(random, 0.1f), OnGrid(random, 0.1f), OnGrid(random, 0.1f)};
       Ray ray{.origin = OnGrid(random, 0.1f), .direction = {-0.0f, 0.0f, 0.0f}};
       ray.direction[static_cast<int>(random.Below(3))] = random.Below(2) == 0 ? 1 : -3;
       return Case{ray, triangle};
     }},
};

// TestTriangle and Round against the oracle. Returns whether it is a hit.
bool Check(const Ray& ray, const Triangle& triangle) {
  const auto expected = FindRationalHit(ray, triangle);
  Candidate candidate;
  const bool hit = TestTriangle(ray, triangle, 0, Culling::kNone, &candidate);
  EXPECT_EQ(hit, expected.has_value());
  EXPECT_EQ(TestTriangle(ray, triangle, 0, Culling::kBack, &candidate), expected && !expected->back);
  EXPECT_EQ(TestTriangle(ray, triangle, 0, Culling::kFront, &candidate), expected && expected->back);
  if (!hit || !expected) return false;

  TestTriangle(ray, triangle, 0, Culling::kNone, &candidate);
  EXPECT_EQ(candidate.back, expected->back);
  const auto is_within = [](double x, double error, const Rational& exact) {
    return std::isinf(error) || (ToRational(x - error) <= exact && exact <= ToRational(x + error));
  };
  EXPECT_TRUE(is_within(candidate.t, candidate.t_error, expected->t));
  EXPECT_TRUE(is_within(candidate.u, candidate.u_error, expected->u));
  EXPECT_TRUE(is_within(candidate.v, candidate.v_error, expected->v));

  const std::array<Vec3f, 3> positions = {triangle.v0, triangle.v1, triangle.v2};
  const std::array<std::array<uint32_t, 3>, 1> indices = {{{0, 1, 2}}};
  const Hit rounded = Round(ray, {positions, indices}, candidate);
  EXPECT_EQ(rounded.primitive, 0u);
  EXPECT_EQ(rounded.back, expected->back);
  EXPECT_TRUE(IsNearestEven(rounded.t, expected->t)) << rounded.t;
  EXPECT_TRUE(IsNearestEven(rounded.u, expected->u)) << rounded.u;
  EXPECT_TRUE(IsNearestEven(rounded.v, expected->v)) << rounded.v;
  return true;
}

TEST(TriangleTestTest, AgreesWithRationalsInEachFamily) {
  for (const Family& family : kFamilies) {
    Random random(11);
    int hits = 0;
    for (int i = 0; i < 500 && !testing::Test::HasFailure(); ++i) {
      SCOPED_TRACE(std::string(family.name) + ", case " + std::to_string(i));
      Case c = family.make(random);
      c.ray.t_min = -kInf;
      const bool hit = Check(c.ray, c.triangle);
      hits += hit;
      if (!hit) continue;
      // The interval ends at the hit, as far as it can be told in float32, or one step off.
      Candidate candidate;
      TestTriangle(c.ray, c.triangle, 0, Culling::kNone, &candidate);
      const auto t = static_cast<float>(candidate.t);
      for (const float end : {t, std::nextafter(t, kInf), std::nextafter(t, -kInf), 0.0f, kMax}) {
        Ray ray = c.ray;
        ray.t_min = end;
        Check(ray, c.triangle);
        ray.t_min = -kInf;
        ray.t_max = end;
        Check(ray, c.triangle);
      }
    }
    ASSERT_GT(hits, 5) << family.name;
  }
}

TEST(TriangleTestTest, IsDegenerateAgreesWithRationals) {
  int degenerate = 0;
  for (const Family& family : kFamilies) {
    Random random(12);
    for (int i = 0; i < 300; ++i) {
      Triangle triangle = family.make(random).triangle;
      if (i % 3 == 0) triangle.v2 = ToFloat(PointOf(random, {triangle.v0, triangle.v1, triangle.v1}));
      const Vec3r v0 = ToRational(triangle.v0);
      const bool expected =
          Cross<Rational>(ToRational(triangle.v1) - v0, ToRational(triangle.v2) - v0) == Vec3r{0, 0, 0};
      EXPECT_EQ(IsDegenerate(triangle), expected) << family.name << ", case " << i;
      degenerate += expected;
    }
  }
  EXPECT_GT(degenerate, 300);
}

TEST(TriangleTestTest, BeforeAgreesWithRationals) {
  int ties = 0, inverted = 0;
  for (const Family& family : kFamilies) {
    Random random(13);
    for (int i = 0; i < 300; ++i) {
      Case c = family.make(random);
      // A second triangle with a corner in common, or a copy, or one that is turned, or one in the same plane.
      Triangle other = c.triangle;
      if (i % 4 == 0) other.v1 = family.make(random).triangle.v1;
      if (i % 4 == 1) other.v0 = family.make(random).triangle.v0;
      if (i % 4 == 2) std::swap(other.v0, other.v2);
      if (i % 8 == 3) other.v2 = family.make(random).triangle.v2;
      if (i % 8 == 4) {
        const int axis = i / 8 % 3;
        for (Vec3f* corner : {&c.triangle.v1, &c.triangle.v2, &other.v1, &other.v2}) {
          (*corner)[axis] = c.triangle.v0[axis];
        }
      }
      Ray ray = c.ray;
      ray.t_min = -kInf;
      const auto a = FindRationalHit(ray, c.triangle), b = FindRationalHit(ray, other);
      if (!a || !b) continue;
      const std::array<Vec3f, 6> positions = {c.triangle.v0, c.triangle.v1, c.triangle.v2,
                                              other.v0,      other.v1,      other.v2};
      const std::array<std::array<uint32_t, 3>, 2> indices = {{{0, 1, 2}, {3, 4, 5}}};
      const TrianglesView view{positions, indices};
      Candidate first, second;
      ASSERT_TRUE(TestTriangle(ray, view[0], 0, Culling::kNone, &first));
      ASSERT_TRUE(TestTriangle(ray, view[1], 1, Culling::kNone, &second));
      EXPECT_EQ(Before(ray, view, first, second), a->t <= b->t) << family.name << ", case " << i;
      EXPECT_EQ(Before(ray, view, second, first), b->t < a->t) << family.name << ", case " << i;
      EXPECT_FALSE(Before(ray, view, first, first));
      ties += a->t == b->t;
      inverted += b->t < a->t;
    }
  }
  EXPECT_GT(ties, 100);
  EXPECT_GT(inverted, 50);
}

// A triangle in the plane z = `z` around the z axis, seen counter-clockwise from above.
Triangle Flat(float z) { return {{-1, -1, z}, {1, -1, z}, {0, 1, z}}; }

Hit Trace(const Ray& ray, const Triangle& triangle) {
  Candidate candidate;
  if (!TestTriangle(ray, triangle, 0, Culling::kNone, &candidate)) return {};
  const std::array<Vec3f, 3> positions = {triangle.v0, triangle.v1, triangle.v2};
  const std::array<std::array<uint32_t, 3>, 1> indices = {{{0, 1, 2}}};
  return Round(ray, {positions, indices}, candidate);
}

TEST(TriangleTestTest, RoundsTiesToEven) {
  EXPECT_EQ(Trace({.origin = {0, 0, -1}, .direction = {0, 0, 1}}, Flat(0x1p24f)).t, 0x1p24f);
  EXPECT_EQ(Trace({.origin = {0, 0, -3}, .direction = {0, 0, 1}}, Flat(0x1p24f)).t, 0x1p24f + 4);
  // Beside a tie, at 2^24 + 1 by 2^-149.
  const Triangle tilted{{-1, -1, 0x1p24f}, {1, -1, 0x1p24f}, {0, 1, 0x1p24f + 2}};
  EXPECT_EQ(Trace({.origin = {0, 0, 0}, .direction = {0, 0, 1}}, tilted).t, 0x1p24f);
  EXPECT_EQ(Trace({.origin = {0, 0, -kDenormal}, .direction = {0, 0, 1}}, tilted).t, 0x1p24f + 2);
  EXPECT_EQ(Trace({.origin = {0, 0, kDenormal}, .direction = {0, 0, 1}}, tilted).t, 0x1p24f);
}

TEST(TriangleTestTest, RoundsToDenormalsAndZero) {
  EXPECT_EQ(Trace({.origin = {0, 0, 0}, .direction = {0, 0, 2}}, Flat(3 * kDenormal)).t, 2 * kDenormal);
  EXPECT_EQ(Trace({.origin = {0, 0, 0}, .direction = {0, 0, 4}}, Flat(5 * kDenormal)).t, kDenormal);
  const Hit tiny = Trace({.origin = {0, 0, 0}, .direction = {0, 0, 0x1p100f}}, Flat(-kDenormal));
  EXPECT_FALSE(tiny.IsHit()) << "t is less than 0, though it rounds to it";
  const Hit behind = Trace({.origin = {0, 0, 0}, .t_min = -1, .direction = {0, 0, 0x1p100f}}, Flat(-kDenormal));
  EXPECT_TRUE(behind.IsHit());
  EXPECT_EQ(behind.t, 0);
  EXPECT_FALSE(std::signbit(behind.t));
}

TEST(TriangleTestTest, RoundsToInfinity) {
  const Triangle far = Flat(kMax);
  const Hit hit = Trace({.origin = {0, 0, 0}, .direction = {0, 0, 0.5f}}, far);
  EXPECT_TRUE(hit.IsHit());
  EXPECT_EQ(hit.t, kInf);
  EXPECT_FALSE(Trace({.origin = {0, 0, 0}, .direction = {0, 0, 0.5f}, .t_max = kMax}, far).IsHit());
  EXPECT_EQ(Trace({.origin = {0, 0, 0}, .direction = {0, 0, 1}, .t_max = kMax}, far).t, kMax);
}

TEST(TriangleTestTest, InfiniteIntervals) {
  const Triangle triangle = Flat(-5);
  const Ray ray{.origin = {0, 0, 0}, .direction = {0, 0, 1}};
  for (const auto& [t_min, t_max, hit] :
       {std::tuple(-kInf, kInf, true), std::tuple(-kInf, 0.0f, true), std::tuple(0.0f, kInf, false),
        std::tuple(kInf, kInf, false), std::tuple(-kInf, -kInf, false), std::tuple(kInf, -kInf, false),
        std::tuple(-4.0f, -6.0f, false), std::tuple(-5.0f, -5.0f, true)}) {
    Ray limited = ray;
    limited.t_min = t_min;
    limited.t_max = t_max;
    EXPECT_EQ(Trace(limited, triangle).IsHit(), hit) << t_min << " " << t_max;
  }
}

TEST(TriangleTestTest, SidesAreToldByTheOrderOfCorners) {
  const Triangle triangle = Flat(0);
  const Ray from_above{.origin = {0, 0, 1}, .direction = {0, 0, -1}},
      from_below{.origin = {0, 0, -1}, .direction = {0, 0, 1}};
  EXPECT_FALSE(Trace(from_above, triangle).back);
  EXPECT_TRUE(Trace(from_below, triangle).back);
}

TEST(TriangleTestTest, ZeroDirectionMisses) {
  EXPECT_FALSE(Trace({.origin = {0, 0, 0}, .direction = {0, -0.0f, 0}}, Flat(0)).IsHit());
}

}  // namespace
}  // namespace deltaray
