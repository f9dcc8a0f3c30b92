#include "tests/oracle/oracle.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "gtest/gtest.h"
#include "server/mesh/triangle_mesh.h"
#include "tests/oracle/exact_hit.h"
#include "tests/oracle/judge.h"
#include "tests/oracle/rational_hit.h"
#include "tests/scenes/hard_rays.h"
#include "tests/scenes/pathological.h"
#include "tests/scenes/shapes.h"

namespace deltaray {
namespace {

// Three squares facing down the z axis, at z = 1 twice and at z = 3 once.
TriangleMesh Squares() {
  TriangleMesh mesh;
  for (const double z : {3.0, 1.0, 1.0}) AddParallelogram(&mesh, {0, 0, z}, {0, 1, 0}, {1, 0, 0});
  return mesh;
}

TEST(ExactHitTest, AgreesWithRationals) {
  size_t hits = 0;
  for (const PathologicalScene& scene : PathologicalScenes()) {
    const TriangleMesh mesh = scene.make(std::min(scene.small_size, 8u));
    if (mesh.indices.empty()) continue;
    for (const HardRays& family : HardRayFamilies()) {
      for (const Ray& ray : family.make(mesh, 6, 5)) {
        for (uint32_t i = 0; i < std::min<size_t>(mesh.indices.size(), 12); ++i) {
          const auto found = FindExactHit(ray, mesh.triangles()[i]);
          const auto expected = FindRationalHit(ray, mesh.triangles()[i]);
          ASSERT_EQ(found.has_value(), expected.has_value()) << scene.name << ", " << family.name;
          if (!found) continue;
          ++hits;
          EXPECT_EQ(found->back, expected->back);
          EXPECT_TRUE(IsNearestEven(RoundToFloat(found->t), expected->t));
          EXPECT_TRUE(IsNearestEven(RoundToFloat(found->u), expected->u));
          EXPECT_TRUE(IsNearestEven(RoundToFloat(found->v), expected->v));
        }
      }
    }
  }
  EXPECT_GT(hits, 500u);
}

TEST(OracleTest, OrdersByTThenId) {
  const TriangleMesh mesh = Squares();
  const Oracle oracle(mesh.triangles());
  // Through the diagonal, and so through both triangles of each square.
  const Ray ray{.origin = {0.5f, 0.5f, 0}, .direction = {0, 0, 2}};
  const std::vector<OracleHit> hits = oracle.AllHits(ray);
  ASSERT_EQ(hits.size(), 6u);
  const uint32_t primitives[] = {2, 3, 4, 5, 0, 1};
  for (size_t i = 0; i < hits.size(); ++i) {
    EXPECT_EQ(hits[i].primitive, primitives[i]);
    EXPECT_EQ(hits[i].t, i < 4 ? 0.5f : 1.5f);
    EXPECT_EQ(hits[i].u, i % 2 == 0 ? 0 : 0.5);
    EXPECT_EQ(hits[i].v, i % 2 == 0 ? 0.5 : 0);
    EXPECT_FALSE(hits[i].back);
  }
  EXPECT_EQ(oracle.ClosestHit(ray)->primitive, 2u);
  EXPECT_EQ(oracle.CompareT(ray, 2, 5), 0);
  EXPECT_EQ(oracle.CompareT(ray, 2, 0), -1);
}

TEST(OracleTest, HeedsIntervalExclusionAndCulling) {
  const TriangleMesh mesh = Squares();
  const Oracle oracle(mesh.triangles());
  Ray ray{.origin = {0.25f, 0.5f, 0}, .direction = {0, 0, 1}};
  EXPECT_EQ(oracle.AllHits(ray).size(), 3u);
  EXPECT_EQ(oracle.AllHits(ray, Culling::kFront).size(), 0u);
  EXPECT_EQ(oracle.AllHits(ray, Culling::kBack).size(), 3u);
  ray.excluded_primitive = oracle.ClosestHit(ray)->primitive;
  EXPECT_EQ(oracle.AllHits(ray).size(), 2u);
  ray.t_min = ray.t_max = 3;
  EXPECT_EQ(oracle.AllHits(ray).size(), 1u);
  ray.t_max = 1;
  EXPECT_FALSE(oracle.ClosestHit(ray).has_value()) << "an empty interval";
  ray = {.origin = {0.25f, 0.5f, 1}, .direction = {0, 0, 0}};
  EXPECT_FALSE(oracle.ClosestHit(ray).has_value()) << "a direction of no length";
  ray = {.origin = {-1, 0.5f, 1}, .direction = {1, 0, 0}};
  EXPECT_FALSE(oracle.ClosestHit(ray).has_value()) << "in the plane";
}

TEST(JudgeTest, TellsMistakesApart) {
  const TriangleMesh mesh = Squares();
  const Oracle oracle(mesh.triangles());
  const Ray ray{.origin = {0.5f, 0.5f, 0}, .direction = {0, 0, 1}}, away{.origin = {0, 0, 0}, .direction = {0, 0, -1}};
  const auto truth = oracle.ClosestHit(ray);
  EXPECT_EQ(Judge(oracle, ray, truth, 2), Verdict::kRight);
  EXPECT_EQ(Judge(oracle, ray, truth, 4), Verdict::kWrongPrimitive);
  EXPECT_EQ(Judge(oracle, ray, truth, 0), Verdict::kWrongSurface);
  EXPECT_EQ(Judge(oracle, ray, truth, kNoPrimitive), Verdict::kFalseMiss);
  EXPECT_EQ(Judge(oracle, away, std::nullopt, kNoPrimitive), Verdict::kRight);
  EXPECT_EQ(Judge(oracle, away, std::nullopt, 1), Verdict::kFalseHit);
}

TEST(JudgeTest, IsRightToTheBit) {
  const TriangleMesh mesh = Squares();
  const Oracle oracle(mesh.triangles());
  const auto truth = oracle.ClosestHit({.origin = {0, 0.625f, 0}, .direction = {1, 0, 3}});
  const Hit right{.t = 1.0f / 3, .u = 7.0f / 24, .v = 1.0f / 3, .primitive = 2};
  const auto with = [](Hit hit, auto Hit::*member, auto value) {
    hit.*member = value;
    return hit;
  };
  EXPECT_TRUE(IsRight(truth, right)) << Describe({}, truth, right);
  EXPECT_FALSE(IsRight(truth, with(right, &Hit::t, std::nextafter(right.t, 1.0f))));
  EXPECT_FALSE(IsRight(truth, with(right, &Hit::u, std::nextafter(right.u, 1.0f))));
  EXPECT_FALSE(IsRight(truth, with(right, &Hit::v, std::nextafter(right.v, 0.0f))));
  EXPECT_FALSE(IsRight(truth, with(right, &Hit::primitive, 4u)));
  EXPECT_FALSE(IsRight(truth, with(right, &Hit::back, true)));
  EXPECT_TRUE(IsRight(std::nullopt, Hit()));
  EXPECT_FALSE(IsRight(std::nullopt, right));
  EXPECT_FALSE(IsRight(std::nullopt, with(Hit(), &Hit::t, 1.0f)));
  EXPECT_FALSE(IsRight(std::nullopt, with(Hit(), &Hit::u, 0.5f)));
  EXPECT_FALSE(IsRight(std::nullopt, with(Hit(), &Hit::v, -0.0f)));
  EXPECT_FALSE(IsRight(std::nullopt, with(Hit(), &Hit::back, true)));
}

TEST(JudgeTest, CountsStepsOfFloat) {
  EXPECT_EQ(StepsApart(1, 1), 0u);
  EXPECT_EQ(StepsApart(0.0f, -0.0f), 0u);
  EXPECT_EQ(StepsApart(1, 1 + 0x1p-23f), 1u);
  EXPECT_EQ(StepsApart(-0x1p-149f, 0x1p-149f), 2u);
}

}  // namespace
}  // namespace deltaray
