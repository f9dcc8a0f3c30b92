#include "server/tree/wide_tree.h"

#include <cmath>
#include <utility>
#include <vector>

#include "gtest/gtest.h"
#include "tests/scenes/random.h"
#include "tests/scenes/rays.h"
#include "tests/scenes/shapes.h"
#include "tests/unit/tree/wide_trees.h"

namespace deltaray {
namespace {

class WideTreeTest : public testing::TestWithParam<SimdTarget> {};

INSTANTIATE_TEST_SUITE_P(Targets, WideTreeTest, testing::ValuesIn(SupportedSimdTargets()),
                         [](const auto& info) { return std::string(Name(info.param)); });

TEST_P(WideTreeTest, AnswersAsBruteForce) {
  for (const uint64_t seed : {1, 2}) {
    const SmallScene scene = GridScene(120, seed);
    for (const auto& [leaf_size, spatial] : {std::pair(1, 0), std::pair(4, 0), std::pair(1, 5), std::pair(8, 3)}) {
      SCOPED_TRACE(testing::Message() << "leaves of " << leaf_size << ", spatial splits to depth " << spatial);
      ExpectSameAsBruteForce(MakeWide(scene.view(), leaf_size, spatial, GetParam()), scene.view(),
                             GridRays(scene, 400, seed + 10));
    }
  }
}

// Rays that do not come near an edge: there, float is right.
TEST_P(WideTreeTest, OrdinaryRaysAreAnsweredAlikeAtEveryLevel) {
  TriangleMesh mesh;
  AddSphere(&mesh, {0.2, -0.1, 0.3}, 1, 24);
  AddSphere(&mesh, {0.2, -0.1, 0.3}, 0.5, 16);
  const WideTree tree = MakeWide(mesh.triangles(), 1, 0, GetParam());
  const std::vector<Ray> rays = ChordRays(MeshBounds(mesh), 5000, 3);
  for (const Culling culling : {Culling::kNone, Culling::kBack, Culling::kFront}) {
    std::vector<Hit> expected(rays.size());
    BruteForce(mesh.triangles()).ClosestHits(rays, {.culling = culling}, expected);
    for (const AccuracyLevel level : kLevels) {
      for (const Traversal traversal : kTraversals) {
        SCOPED_TRACE(testing::Message() << "level " << static_cast<int>(level) << ", traversal "
                                        << static_cast<int>(traversal) << ", culling " << static_cast<int>(culling));
        const QueryOptions options{.culling = culling, .accuracy = level, .traversal = traversal};
        std::vector<Hit> hits(rays.size());
        std::vector<uint8_t> any(rays.size());
        tree.ClosestHits(rays, options, hits);
        tree.AnyHits(rays, options, any);
        size_t others = 0;
        for (size_t i = 0; i < rays.size(); ++i) {
          EXPECT_EQ(any[i] != 0, hits[i].IsHit());
          if (hits[i].primitive != expected[i].primitive) {
            ++others;
            continue;
          }
          if (!expected[i].IsHit()) continue;
          EXPECT_NEAR(hits[i].t, expected[i].t, 2e-6 * std::abs(expected[i].t) + 1e-6);
          EXPECT_NEAR(hits[i].u, expected[i].u, 1e-3);
          EXPECT_NEAR(hits[i].v, expected[i].v, 1e-3);
          EXPECT_EQ(hits[i].back, expected[i].back);
        }
        EXPECT_LE(others, level == AccuracyLevel::kExact ? 0u : rays.size() / 500);
      }
    }
  }
}

// Such a vertex may lie anywhere; were it in the frame, the triangles would be smaller than any float's square.
TEST_P(WideTreeTest, AVertexThatNoTriangleUsesChangesNothing) {
  TriangleMesh mesh;
  AddSphere(&mesh, {0.2, -0.1, 0.3}, 1, 24);
  TriangleMesh with = mesh;
  with.positions.push_back({1e30f, 0, 0});
  const std::vector<Ray> rays = ChordRays(MeshBounds(mesh), 1000, 3);
  const WideTree tree = MakeWide(mesh.triangles(), 1, 0, GetParam());
  const WideTree tree_with = MakeWide(with.triangles(), 1, 0, GetParam());
  for (const AccuracyLevel level : kLevels) {
    std::vector<Hit> hits(rays.size()), hits_with(rays.size());
    tree.ClosestHits(rays, {.accuracy = level}, hits);
    tree_with.ClosestHits(rays, {.accuracy = level}, hits_with);
    EXPECT_EQ(hits, hits_with);
  }
}

// The power of two that scales such a mesh to its frame is beyond float, and a packet's bounds were 0 times infinity.
TEST_P(WideTreeTest, PacketsMeetSubnormalMeshes) {
  for (const float size : {0x1p-126f, 0x1p-130f, 0x1p-146f}) {
    TriangleMesh mesh;
    mesh.positions = {{-size, -size, size}, {size, -size, size}, {0, size, size}};
    mesh.indices = {{0, 1, 2}};
    const WideTree tree = MakeWide(mesh.triangles(), 1, 0, GetParam());
    const std::vector<Ray> rays(64, {.origin = {0, 0, 0}, .direction = {0, 0, 1}});
    std::vector<Hit> hits(rays.size()), expected(rays.size());
    BruteForce(mesh.triangles()).ClosestHits(rays, {}, expected);
    EXPECT_EQ(expected[0].t, size);
    for (const AccuracyLevel level : kLevels) {
      for (const Traversal traversal : kTraversals) {
        tree.ClosestHits(rays, {.accuracy = level, .traversal = traversal}, hits);
        EXPECT_EQ(hits, expected) << size << ", level " << static_cast<int>(level) << ", traversal "
                                  << static_cast<int>(traversal);
      }
    }
  }
}

// Nearly in the plane of a triangle, whose determinant is so small that its inverse is infinite; t = T/det is 0 times
// that.
TEST_P(WideTreeTest, FastHitsAreNumbers) {
  TriangleMesh mesh;
  mesh.positions = {{0, 0, 0}, {0x1p-65f, 1, 0}, {0, 1, 0x1p-65f}};
  mesh.indices = {{0, 1, 2}};
  const WideTree tree = MakeWide(mesh.triangles(), 1, 0, GetParam());
  const std::vector<Ray> rays(1, {.origin = {0x1p-67f, 0.5f, 0x1p-67f}, .direction = {0, 1, 0}});
  std::vector<Hit> hits(1);
  tree.ClosestHits(rays, {}, hits);
  EXPECT_EQ(hits[0].t, 0);
  for (const AccuracyLevel level : kLevels) {
    tree.ClosestHits(rays, {.accuracy = level}, hits);
    EXPECT_FALSE(std::isnan(hits[0].t) || std::isnan(hits[0].u) || std::isnan(hits[0].v)) << static_cast<int>(level);
  }
}

// Rays from within a closed mesh, at its vertices and edges: at kWatertight none gets out.
TEST_P(WideTreeTest, AClosedMeshDoesNotLeak) {
  for (const Vec3d centre : {Vec3d{0, 0, 0}, Vec3d{1000, 1000, 1000}}) {
    TriangleMesh mesh;
    AddSphere(&mesh, centre, 1, 40);
    const WideTree tree = MakeWide(mesh.triangles(), 2, 2, GetParam());
    Random random(11);
    std::vector<Ray> rays;
    for (uint32_t i = 0; i < 10'000; ++i) {
      const auto& corners = mesh.indices[random.Below(static_cast<uint32_t>(mesh.indices.size()))];
      const Vec3f a = mesh.positions[corners[0]], b = mesh.positions[corners[1]];
      const float part = i % 2 == 0 ? 0 : static_cast<float>(random.Below(1000)) / 1000;
      const Vec3f target = a + part * (b - a);
      const auto offset = [&] { return static_cast<float>(random.Below(1000)) / 1000 - 0.5f; };
      Ray& ray = rays.emplace_back();
      ray.origin = static_cast<Vec3f>(centre) + Vec3f{offset(), offset(), offset()};
      ray.direction = target - ray.origin;
    }
    for (const AccuracyLevel level : {AccuracyLevel::kWatertight, AccuracyLevel::kExact}) {
      for (const Traversal traversal : kTraversals) {
        const QueryOptions options{.accuracy = level, .traversal = traversal};
        std::vector<Hit> hits(rays.size());
        std::vector<uint8_t> any(rays.size());
        tree.ClosestHits(rays, options, hits);
        tree.AnyHits(rays, options, any);
        size_t leaks = 0;
        for (size_t i = 0; i < rays.size(); ++i) leaks += !hits[i].IsHit() + !any[i];
        EXPECT_EQ(leaks, 0u) << static_cast<int>(level) << ' ' << static_cast<int>(traversal);
      }
    }
  }
}

// A pyramid whose base is divided around a triangle so small that float's determinants are near their end; at kExact
// beyond it, where kWatertight would have a hole.
TEST_P(WideTreeTest, AClosedMeshWithATinyTriangleDoesNotLeak) {
  for (const auto& [half, level] :
       {std::pair(0x1p-60f, AccuracyLevel::kWatertight), std::pair(0x1p-70f, AccuracyLevel::kExact)}) {
    SmallScene scene;
    const Vec3f outer[] = {{-1, -1, 0}, {1, -1, 0}, {0, 1, 0}}, apex{0, 0, -1};
    const Vec3f inner[] = {half * outer[0], half * outer[1], half * outer[2]};
    scene.Add({inner[0], inner[1], inner[2]});
    for (int i = 0, next = 1; i < 3; ++i, next = (next + 1) % 3) {
      scene.Add({outer[i], outer[next], inner[next]});
      scene.Add({outer[i], inner[next], inner[i]});
      scene.Add({outer[next], outer[i], apex});
    }
    const WideTree tree = MakeWide(scene.view(), 2, 0, GetParam());
    // Through its middle from many sides, from outside and from within, and side by side through and around it.
    std::vector<Ray> rays;
    for (const Vec3f from : {Vec3f{0, 0, 1},
                             {0.5f, 0.25f, 1},
                             {-0.3f, 0.7f, 1},
                             {2, 1, 0.5f},
                             {0.25f, -1, 0.125f},
                             {0, 0.125f, -0.25f},
                             {0.07f, 0, -0.5f},
                             {0, 0, -0.5f}}) {
      rays.insert(rays.end(), 16, {.origin = from, .direction = -1.0f * from});
    }
    for (int x = -8; x <= 8; ++x) {
      for (int y = -8; y <= 8; ++y) {
        rays.push_back({.origin = {0.25f * half * x, 0.25f * half * y, 1}, .direction = {0, 0, -1}});
      }
    }
    std::vector<Hit> hits(rays.size()), expected(rays.size());
    std::vector<uint8_t> any(rays.size());
    BruteForce(scene.view()).ClosestHits(rays, {}, expected);
    EXPECT_EQ(expected[0].primitive, 0u);
    for (const Traversal traversal : kTraversals) {
      const QueryOptions options{.accuracy = level, .traversal = traversal};
      tree.ClosestHits(rays, options, hits);
      tree.AnyHits(rays, options, any);
      for (size_t i = 0; i < rays.size(); ++i) {
        SCOPED_TRACE(testing::Message() << "half width " << half << ", traversal " << static_cast<int>(traversal)
                                        << ", ray " << i);
        EXPECT_NEAR(hits[i].t, 1, 1e-6);
        EXPECT_EQ(any[i], 1);
        if (level == AccuracyLevel::kExact) {
          EXPECT_EQ(hits[i], expected[i]);
        }
      }
    }
  }
}

TEST_P(WideTreeTest, ExcludedPrimitivesAreSkippedAtEveryLevel) {
  SmallScene scene;
  for (int i = 0; i < 20; ++i) {
    const auto z = static_cast<float>(i);
    scene.Add({{-1, -1, z}, {3, -1, z}, {-1, 3, z}});
  }
  const WideTree tree = MakeWide(scene.view(), 1, 0, GetParam());
  std::vector<Ray> rays(40, {.origin = {0, 0, -1}, .direction = {0, 0, 1}, .excluded_primitive = 0});
  for (const AccuracyLevel level : kLevels) {
    std::vector<Hit> hits(rays.size());
    tree.ClosestHits(rays, {.accuracy = level}, hits);
    for (const Hit& hit : hits) {
      EXPECT_EQ(hit.primitive, 1u);
      EXPECT_EQ(hit.t, 2);
    }
    rays[0].t_max = 1;
    std::vector<uint8_t> any(rays.size());
    tree.AnyHits(rays, {.accuracy = level}, any);
    EXPECT_EQ(any[0], 0);
    EXPECT_EQ(any[1], 1);
    rays[0].t_max = Ray().t_max;
  }
}

// Rays within rounding of a triangle's plane: the determinant's sign is beyond float.
TEST_P(WideTreeTest, RaysThatGrazeTrianglesAreAnsweredAsBruteForce) {
  Random random(29);
  const auto coordinate = [&] { return static_cast<float>(random.Below(1u << 20)) / (1 << 19) - 1; };
  SmallScene scene;
  for (int i = 0; i < 60; ++i) {
    scene.Add({{coordinate(), coordinate(), coordinate()},
               {coordinate(), coordinate(), coordinate()},
               {coordinate(), coordinate(), coordinate()}});
  }
  std::vector<Ray> rays;
  for (size_t i = 0; i < 6000; ++i) {
    const Triangle t = scene.view()[i % scene.view().size()];
    const auto in_plane = [&](float a, float b) { return t.v0 + a * (t.v1 - t.v0) + b * (t.v2 - t.v0); };
    Ray& ray = rays.emplace_back();
    ray.origin = in_plane(-coordinate(), 1.5f + coordinate());
    ray.direction = in_plane(0.3f, 0.3f + 0.1f * coordinate()) - ray.origin;
  }
  const WideTree tree = MakeWide(scene.view(), 2, 2, GetParam());
  std::vector<Hit> hits(rays.size()), expected(rays.size());
  BruteForce(scene.view()).ClosestHits(rays, {}, expected);
  for (const Traversal traversal : kTraversals) {
    tree.ClosestHits(rays, {.traversal = traversal}, hits);
    EXPECT_TRUE(hits == expected) << static_cast<int>(traversal);
  }
}

// Origins a few of the least floats from a corner: there, no error is relative to anything.
TEST_P(WideTreeTest, RaysFromNearlyACornerAreAnsweredAsBruteForce) {
  Random random(31);
  const auto point = [&] { return Vec3f(random.OnUnitSphere()); };
  const auto few = [&] { return static_cast<float>(random.Below(7)) * 0x1p-149f - 3 * 0x1p-149f; };
  for (int i = 0; i < 400; ++i) {
    SmallScene scene;
    scene.Add({{0, 0, 0}, point(), point()});
    std::vector<Ray> rays(64);
    for (Ray& ray : rays) {
      ray.origin = {few(), few(), few()};
      ray.direction = point();
    }
    const WideTree tree = MakeWide(scene.view(), 1, 0, GetParam());
    const BruteForce brute_force(scene.view());
    std::vector<Hit> hits(rays.size()), expected(rays.size());
    std::vector<uint8_t> any(rays.size()), expected_any(rays.size());
    brute_force.ClosestHits(rays, {}, expected);
    brute_force.AnyHits(rays, {}, expected_any);
    tree.ClosestHits(rays, {}, hits);
    tree.AnyHits(rays, {}, any);
    EXPECT_EQ(hits, expected);
    EXPECT_EQ(any, expected_any);
  }
}

// An interval that ends just short of a hit, or begins just beyond it: t as rounded is never out of it, at any level,
// and there is any hit where there is a closest one.
TEST_P(WideTreeTest, HitsAreInTheInterval) {
  Random random(37);
  SmallScene scene;
  scene.Add({{-1, -1, 0.25f}, {1, -1, -0.5f}, {0, 1, 0.125f}});
  const WideTree tree = MakeWide(scene.view(), 1, 0, GetParam());
  std::vector<Ray> rays(4000);
  for (Ray& ray : rays) {
    ray.origin = Vec3f(3.0 * random.OnUnitSphere());
    ray.direction = Vec3f(0.3 * random.OnUnitSphere()) - ray.origin;
  }
  std::vector<Hit> hits(rays.size());
  std::vector<uint8_t> any(rays.size());
  for (const AccuracyLevel level : kLevels) {
    for (const bool end : {false, true}) {
      std::vector<Ray> asked = rays;
      tree.ClosestHits(asked, {.accuracy = level}, hits);
      for (size_t i = 0; i < asked.size(); ++i) {
        if (!hits[i].IsHit()) continue;
        const float other = std::nextafter(hits[i].t, end ? -1e9f : 1e9f);
        (end ? asked[i].t_max : asked[i].t_min) = other;
      }
      for (const Traversal traversal : kTraversals) {
        tree.ClosestHits(asked, {.accuracy = level, .traversal = traversal}, hits);
        tree.AnyHits(asked, {.accuracy = level, .traversal = traversal}, any);
        for (size_t i = 0; i < asked.size(); ++i) {
          EXPECT_EQ(hits[i].IsHit(), any[i] != 0) << i;
          if (!hits[i].IsHit() || level == AccuracyLevel::kExact) continue;
          EXPECT_TRUE(hits[i].t >= asked[i].t_min && hits[i].t <= asked[i].t_max) << i;
        }
      }
    }
  }
}

// Copies have the same t, whatever the level, and the order in which leaves come does not matter.
TEST_P(WideTreeTest, OfCopiesTheFirstIsHit) {
  Random random(41);
  SmallScene scene;
  for (int i = 0; i < 20; ++i) scene.Add({{-1, -1, 0.25f}, {1, -1, -0.5f}, {0, 1, 0.125f}});
  const WideTree tree = MakeWide(scene.view(), 1, 0, GetParam());
  std::vector<Ray> rays(2000);
  for (Ray& ray : rays) {
    ray.origin = Vec3f(3.0 * random.OnUnitSphere());
    ray.direction = Vec3f(0.3 * random.OnUnitSphere()) - ray.origin;
    ray.excluded_primitive = random.Below(2) == 0 ? 0 : kNoPrimitive;
  }
  std::vector<Hit> hits(rays.size());
  for (const AccuracyLevel level : kLevels) {
    for (const Traversal traversal : kTraversals) {
      tree.ClosestHits(rays, {.accuracy = level, .traversal = traversal}, hits);
      for (size_t i = 0; i < rays.size(); ++i) {
        if (!hits[i].IsHit()) continue;
        EXPECT_EQ(hits[i].primitive, rays[i].excluded_primitive == 0 ? 1u : 0u) << i;
      }
    }
  }
}

// Neighbours in a batch whose directions have nothing in common but their signs, in length neither.
TEST_P(WideTreeTest, RaysOfVeryDifferentLengthsShareNoPacket) {
  const SmallScene scene = GridScene(100, 3);
  const WideTree tree = MakeWide(scene.view(), 1, 0, GetParam());
  std::vector<Ray> rays(64);
  for (size_t i = 0; i < rays.size(); ++i) {
    const float length = std::ldexp(1.0f, static_cast<int>(i * 37 % 220) - 110);
    rays[i].origin = {-1, 0.25f * static_cast<float>(i % 7), -1};
    rays[i].direction = {length, 0.25f * length, (i % 3 == 0 ? 1.0f : 0.5f) * length};
  }
  std::vector<Hit> hits(rays.size()), expected(rays.size());
  BruteForce(scene.view()).ClosestHits(rays, {}, expected);
  for (const Traversal traversal : kTraversals) {
    tree.ClosestHits(rays, {.traversal = traversal}, hits);
    EXPECT_EQ(hits, expected) << static_cast<int>(traversal);
  }
}

TEST_P(WideTreeTest, EmptyTreeMisses) {
  const SmallScene scene;
  const WideTree tree = MakeWide(scene.view(), 1, 0, GetParam());
  ExpectSameAsBruteForce(tree, scene.view(), std::vector<Ray>{{.origin = {0, 0, 0}, .direction = {0, 0, 1}}});
  EXPECT_EQ(tree.Shape().nodes, 0u);
}

TEST_P(WideTreeTest, Shape) {
  SmallScene scene;
  for (int i = 0; i < 20; ++i) {
    const auto x = static_cast<float>(2 * i);
    scene.Add({{x, 0, 0}, {x + 1, 0, 1}, {x, 1, 0}});
  }
  const WideTree tree = MakeWide(scene.view(), 1, 0, GetParam());
  const TreeShape shape = tree.Shape();
  EXPECT_EQ(shape.references, 20u);
  EXPECT_GE(shape.leaves, 3u);
  EXPECT_GT(shape.nodes, shape.leaves);
  EXPECT_EQ(shape.node_bytes + shape.reference_bytes + kLeafSlack, tree.arrays().block.size());
  EXPECT_EQ(shape.max_depth, tree.arrays().levels);
}

}  // namespace
}  // namespace deltaray
