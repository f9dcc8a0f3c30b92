// Rays on their own, in batches, packets and streams: the same answers, to the bit.

#include <algorithm>
#include <bit>
#include <limits>
#include <tuple>
#include <vector>

#include "gtest/gtest.h"
#include "tests/scenes/hard_rays.h"
#include "tests/scenes/pathological.h"
#include "tests/scenes/random.h"
#include "tests/unit/tree/wide_trees.h"

namespace deltaray {
namespace {

class TraversalTest : public testing::TestWithParam<SimdTarget> {};

INSTANTIATE_TEST_SUITE_P(Targets, TraversalTest, testing::ValuesIn(SupportedSimdTargets()),
                         [](const auto& info) { return std::string(Name(info.param)); });

TEST_P(TraversalTest, EveryWayThroughTheTreeGivesTheSameBits) {
  for (const PathologicalScene& pathological : PathologicalScenes()) {
    SCOPED_TRACE(pathological.name);
    const TriangleMesh mesh = pathological.make(std::min(pathological.small_size, 200u));
    if (mesh.indices.empty()) continue;
    const WideTree tree = MakeWide(mesh.triangles(), 2, 3, GetParam());
    const BruteForce brute_force(mesh.triangles());
    for (const HardRays& family : HardRayFamilies()) {
      SCOPED_TRACE(family.name);
      const std::vector<Ray> rays = family.make(mesh, 40, 7);
      std::vector<Hit> hits(rays.size()), expected(rays.size());
      std::vector<uint8_t> any(rays.size()), expected_any(rays.size());
      brute_force.ClosestHits(rays, {}, expected);
      brute_force.AnyHits(rays, {}, expected_any);
      for (const Traversal traversal : kTraversals) {
        const QueryOptions options{.traversal = traversal};
        tree.ClosestHits(rays, options, hits);
        EXPECT_EQ(hits, expected) << static_cast<int>(traversal);
        tree.AnyHits(rays, options, any);
        EXPECT_EQ(any, expected_any) << static_cast<int>(traversal);
      }
    }
  }
}

// Sixteen rays at a time that go about the same way, with ends and exclusions of their own: no two of a group are alike
// in all, and packets take them.
std::vector<Ray> CoherentRays(const SmallScene& scene, uint32_t groups, uint64_t seed) {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  Random random(seed);
  std::vector<Ray> rays;
  for (uint32_t group = 0; group < groups; ++group) {
    const Vec3f origin = group % 2 == 0 ? Vec3f{3.5f, 3.25f, -4} : GridPoint(random, 8);
    const Vec3f direction = GridPoint(random, 8) - origin + Vec3f{0.125f, 0.25f, 0.375f};
    for (uint32_t i = 0; i < 16; ++i) {
      const auto offset = [&] { return (static_cast<float>(random.Below(64)) - 32) * 0x1p-10f; };
      Ray& ray = rays.emplace_back();
      ray.origin = origin;
      ray.direction = direction + Vec3f{offset(), offset(), offset()};
      const float starts[] = {0, 0, -0.0f, -kInfinity, -1, 0.5f},
                  ends[] = {kInfinity, kInfinity, 1, 0.75f, 0.25f, -0.0f};
      ray.t_min = starts[random.Below(6)];
      ray.t_max = ends[random.Below(6)];
      if (random.Below(3) == 0) {
        ray.excluded_primitive = random.Below(static_cast<uint32_t>(scene.indices.size()));
      }
    }
  }
  return rays;
}

TEST_P(TraversalTest, EveryWayThroughTheTreeGivesTheSameBitsAtEveryLevel) {
  const auto bits = [](const Hit& hit) {
    return std::tuple(std::bit_cast<uint32_t>(hit.t), std::bit_cast<uint32_t>(hit.u), std::bit_cast<uint32_t>(hit.v),
                      hit.primitive, hit.back);
  };
  for (const size_t leaf_size : {1, 3, 8}) {
    const SmallScene scene = GridScene(120, leaf_size);
    const WideTree tree = MakeWide(scene.view(), leaf_size, 0, GetParam());
    const std::vector<Ray> rays = CoherentRays(scene, 150, leaf_size + 20);
    std::vector<Hit> hits(rays.size()), expected(rays.size());
    std::vector<uint8_t> any(rays.size()), expected_any(rays.size());
    for (const AccuracyLevel level : kLevels) {
      for (const Culling culling : {Culling::kNone, Culling::kBack, Culling::kFront}) {
        QueryOptions options{.culling = culling, .accuracy = level, .traversal = Traversal::kSingle};
        tree.ClosestHits(rays, options, expected);
        tree.AnyHits(rays, options, expected_any);
        for (const Traversal traversal : kTraversals) {
          SCOPED_TRACE(testing::Message()
                       << "leaves of " << leaf_size << ", level " << static_cast<int>(level) << ", culling "
                       << static_cast<int>(culling) << ", traversal " << static_cast<int>(traversal));
          options.traversal = traversal;
          tree.ClosestHits(rays, options, hits);
          tree.AnyHits(rays, options, any);
          for (size_t i = 0; i < rays.size(); ++i) ASSERT_EQ(bits(hits[i]), bits(expected[i])) << "ray " << i;
          ASSERT_EQ(any, expected_any);
        }
      }
    }
  }
}

}  // namespace
}  // namespace deltaray
