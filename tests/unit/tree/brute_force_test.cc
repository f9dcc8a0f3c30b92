#include "server/tree/brute_force.h"

#include <algorithm>
#include <optional>
#include <utility>
#include <vector>

#include "gtest/gtest.h"
#include "tests/oracle/rational_hit.h"
#include "tests/unit/tree/small_trees.h"

namespace deltaray {
namespace {

// All hits of a ray by the oracle, in order.
std::vector<std::pair<Rational, uint32_t>> OracleHits(const SmallScene& scene, const Ray& ray, Culling culling) {
  std::vector<std::pair<Rational, uint32_t>> hits;
  for (uint32_t i = 0; i < scene.indices.size(); ++i) {
    if (i == ray.excluded_primitive) continue;
    const auto hit = FindRationalHit(ray, scene.view()[i]);
    if (!hit || (culling == (hit->back ? Culling::kBack : Culling::kFront))) continue;
    hits.emplace_back(hit->t, i);
  }
  std::sort(hits.begin(), hits.end());
  return hits;
}

TEST(BruteForceTest, AnswersAllKindsAsRationalsDo) {
  const SmallScene scene = GridScene(40, 1);
  const std::vector<Ray> rays = GridRays(scene, 300, 2);
  const BruteForce tree(scene.view());
  size_t seen = 0;
  for (const Culling culling : {Culling::kNone, Culling::kBack, Culling::kFront}) {
    const QueryOptions options{.culling = culling, .max_hits_per_ray = 4};
    std::vector<Hit> closest(rays.size()), all;
    std::vector<uint8_t> any(rays.size());
    std::vector<uint32_t> counts(rays.size()), all_counts(rays.size());
    tree.ClosestHits(rays, options, closest);
    tree.AnyHits(rays, options, any);
    tree.CountHits(rays, options, counts);
    tree.AllHits(rays, options, &all, all_counts);
    size_t next = 0;
    for (size_t i = 0; i < rays.size(); ++i) {
      SCOPED_TRACE(i);
      const auto expected = OracleHits(scene, rays[i], culling);
      EXPECT_EQ(closest[i].primitive, expected.empty() ? kNoPrimitive : expected[0].second);
      EXPECT_EQ(any[i], !expected.empty());
      EXPECT_EQ(counts[i], expected.size());
      ASSERT_EQ(all_counts[i], std::min<size_t>(expected.size(), 4));
      for (size_t k = 0; k < all_counts[i]; ++k, ++next) {
        EXPECT_EQ(all[next].primitive, expected[k].second);
        EXPECT_TRUE(IsNearestEven(all[next].t, expected[k].first));
      }
      EXPECT_TRUE(expected.empty() || IsNearestEven(closest[i].t, expected[0].first));
      seen += expected.size();
    }
    EXPECT_EQ(next, all.size());
  }
  EXPECT_GT(seen, 300u);
}

TEST(BruteForceTest, MissIsTheDefaultHit) {
  const SmallScene scene;
  const BruteForce tree(scene.view());
  const Ray ray{.origin = {0, 0, 0}, .direction = {0, 0, 1}};
  Hit hit{.t = 1, .primitive = 3};
  tree.ClosestHits({&ray, 1}, {}, {&hit, 1});
  EXPECT_EQ(hit, Hit());
  EXPECT_EQ(tree.Shape().nodes, 0u);
}

TEST(BruteForceTest, ExcludesOnePrimitive) {
  SmallScene scene;
  for (int copy = 0; copy < 3; ++copy) scene.Add({{-1, -1, 1}, {1, -1, 1}, {0, 1, 1}});
  const BruteForce tree(scene.view());
  const Ray ray{.origin = {0, 0, 0}, .direction = {0, 0, 1}, .excluded_primitive = 0};
  Hit hit;
  tree.ClosestHits({&ray, 1}, {}, {&hit, 1});
  EXPECT_EQ(hit.primitive, 1u);
  uint32_t count = 0;
  tree.CountHits({&ray, 1}, {}, {&count, 1});
  EXPECT_EQ(count, 2u);
}

TEST(BruteForceTest, AllHitsAppends) {
  SmallScene scene;
  scene.Add({{-1, -1, 1}, {1, -1, 1}, {0, 1, 1}});
  const BruteForce tree(scene.view());
  const Ray ray{.origin = {0, 0, 0}, .direction = {0, 0, 1}};
  std::vector<Hit> hits(2);
  uint32_t count = 0;
  tree.AllHits({&ray, 1}, {}, &hits, {&count, 1});
  ASSERT_EQ(hits.size(), 3u);
  EXPECT_EQ(hits[2].primitive, 0u);
  EXPECT_EQ(count, 1u);
}

}  // namespace
}  // namespace deltaray
