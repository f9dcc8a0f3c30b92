#include "server/build/lazy_tree.h"

#include <chrono>
#include <functional>
#include <memory>
#include <new>
#include <thread>
#include <utility>
#include <vector>

#include "gtest/gtest.h"
#include "server/build/build.h"
#include "server/build/delta_leaf.h"
#include "server/tree/brute_force.h"
#include "tests/scenes/made.h"
#include "tests/scenes/rays.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

// A lazy tree over a terrain, as a build makes it.
struct Lazy {
  explicit Lazy(SimdTarget target, uint32_t delta = 32, std::function<void()> on_delta_leaf = nullptr)
      : mesh(Terrain(40, 40)) {
    Config config;
    config.delta = delta;
    absl::StatusOr<ReferenceArray> references = MakeReferences(mesh.triangles(), config.duplication_budget, *context);
    absl::StatusOr<SplitTree> top = BuildTop(*std::move(references), mesh.triangles(), config, *context);
    tasks = std::make_shared<DeltaLeafTasks>(
        *std::move(top),
        [config, context = context.get()](std::span<const Reference> delta_leaf, const Bounds& all) {
          return BuildDeltaLeaf(delta_leaf, all, config, *context);
        },
        on_delta_leaf, context);
    delta_leaves = tasks->count();
    tree = std::make_unique<LazyTree>(
        mesh.triangles(), *LazyTree::LayOutVersion(mesh.triangles(), tasks, target, *context), target, context);
  }
  uint64_t built() const { return context->delta_leaves_built; }

  TriangleMesh mesh;
  std::shared_ptr<BuildContext> context = std::make_shared<BuildContext>();
  std::shared_ptr<DeltaLeafTasks> tasks;
  uint64_t delta_leaves = 0;
  std::unique_ptr<LazyTree> tree;
};

// At the middle of each triangle, from above.
std::vector<Ray> RaysAtAll(const TriangleMesh& mesh) {
  std::vector<Ray> rays;
  for (size_t i = 0; i < mesh.indices.size(); ++i) {
    const Triangle t = mesh.triangles()[i];
    const Vec3f middle = (1 / 3.0f) * (t.v0 + t.v1 + t.v2);
    Ray ray{.origin = middle, .direction = {0, 0, -1}};
    ray.origin.z += 1000;
    rays.push_back(ray);
  }
  return rays;
}

class LazyTreeTest : public testing::TestWithParam<SimdTarget> {};

INSTANTIATE_TEST_SUITE_P(Targets, LazyTreeTest, testing::ValuesIn(SupportedSimdTargets()),
                         [](const auto& info) { return std::string(Name(info.param)); });

TEST_P(LazyTreeTest, EveryQueryBuildsWhatItReaches) {
  const std::vector<Ray> rays = RaysAtAll(Terrain(40, 40));
  const std::span<const Ray> one = std::span(rays).subspan(100, 1);
  std::vector<Hit> hits(1);
  std::vector<uint8_t> any(1);
  std::vector<uint32_t> counts(1);
  const std::vector<std::function<void(const Tree&)>> queries = {
      [&](const Tree& tree) { tree.ClosestHits(one, {}, hits); },
      [&](const Tree& tree) { tree.AnyHits(one, {}, any); },
      [&](const Tree& tree) { tree.AllHits(one, {}, &hits, counts); },
      [&](const Tree& tree) { tree.CountHits(one, {}, counts); },
  };
  for (const auto& query : queries) {
    const Lazy lazy(GetParam());
    EXPECT_EQ(lazy.built(), 0u);
    query(*lazy.tree);
    EXPECT_GT(lazy.built(), 0u);
    EXPECT_LT(lazy.built(), lazy.delta_leaves / 4);
  }
}

TEST_P(LazyTreeTest, WhatFoundNoMemoryIsBuiltByLaterRays) {
  int failures = 0;
  // The first two and every third one, δ-leaves of one reference being several to a leaf of the tree.
  const auto on_delta_leaf = [&, n = 0]() mutable {
    if (n++ < 2 || n % 3 == 0) {
      ++failures;
      throw std::bad_alloc();
    }
  };
  for (const uint32_t delta : {1, 32}) {
    SCOPED_TRACE(delta);
    failures = 0;
    const Lazy lazy(GetParam(), delta, on_delta_leaf);
    const std::vector<Ray> rays = RaysAtAll(lazy.mesh);
    std::vector<Hit> expected(rays.size()), hits(rays.size());
    BruteForce(lazy.mesh.triangles()).ClosestHits(rays, {}, expected);
    for (int pass = 0; pass < 10'000 && lazy.tree->is_growing(); ++pass) {
      lazy.tree->ClosestHits(rays, {}, hits);
      ASSERT_EQ(hits, expected);
    }
    EXPECT_FALSE(lazy.tree->is_growing());
    EXPECT_EQ(lazy.built(), lazy.delta_leaves);
    EXPECT_GT(failures, 2);
  }
}

// Threads that trace all over the tree, while it is laid out anew.
TEST_P(LazyTreeTest, BecomesTheFinalTreeAndAnswersAlikeOnTheWay) {
  // δ-leaves of one reference go several to a leaf of the wide tree.
  for (const uint32_t delta : {1, 32}) {
    SCOPED_TRACE(delta);
    Lazy lazy(GetParam(), delta);
    const std::weak_ptr<DeltaLeafTasks> tasks = std::exchange(lazy.tasks, nullptr);
    const std::vector<Ray> rays = RaysAtAll(lazy.mesh);
    std::vector<Hit> expected(rays.size());
    BruteForce(lazy.mesh.triangles()).ClosestHits(rays, {}, expected);

    const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(60);
    std::vector<std::thread> threads;
    for (int i = 0; i < 3; ++i) {
      threads.emplace_back([&] {
        std::vector<Hit> hits(rays.size());
        do {
          lazy.tree->ClosestHits(rays, {}, hits);
          ASSERT_EQ(hits, expected);
        } while (!tasks.expired() && std::chrono::steady_clock::now() < deadline);
      });
    }
    for (std::thread& thread : threads) thread.join();
    EXPECT_TRUE(tasks.expired()) << "what builds δ-leaves is still kept";
    EXPECT_EQ(lazy.built(), lazy.delta_leaves);

    Build::Options options;
    options.config.delta = delta;
    options.simd_target = GetParam();
    const std::shared_ptr<Build> build = Build::Start(std::make_shared<const TriangleMesh>(lazy.mesh), options);
    ASSERT_TRUE(build->WaitDone().ok());
    EXPECT_EQ(lazy.tree->Shape().sah_cost, build->snapshot()->tree->Shape().sah_cost);
    EXPECT_EQ(lazy.tree->Shape().nodes, build->snapshot()->tree->Shape().nodes);
  }
}

}  // namespace
}  // namespace deltaray
