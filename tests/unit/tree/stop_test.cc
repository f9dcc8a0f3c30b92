// Queries that nobody waits for end soon, within a ray too.

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "gtest/gtest.h"
#include "tests/unit/tree/wide_trees.h"

namespace deltaray {
namespace {

constexpr uint32_t kTriangles = 3000;
constexpr uint32_t kRays = 32;

// Right triangles in one plane, of about the same box, so that a ray has to look at all of them.
SmallScene Stack() {
  SmallScene scene;
  for (uint32_t i = 0; i < kTriangles; ++i) {
    const float size = 4 + static_cast<float>(i) * 0x1p-13f;
    scene.Add({{0, 0, 0}, {size, 0, 0}, {0, size, 0}});
  }
  return scene;
}

std::vector<Ray> RaysDown(float x) {
  std::vector<Ray> rays(kRays);
  for (uint32_t i = 0; i < kRays; ++i) {
    rays[i].origin = {x + static_cast<float>(i) * 0x1p-10f, x, 1};
    rays[i].direction = {0x1p-12f, 0x1p-12f, -1};
  }
  return rays;
}

struct Answers {
  std::vector<Hit> closest = std::vector<Hit>(kRays);
  std::vector<uint8_t> any = std::vector<uint8_t>(kRays);
  std::vector<Hit> all;
  std::vector<uint32_t> all_counts = std::vector<uint32_t>(kRays);
  std::vector<uint32_t> counts = std::vector<uint32_t>(kRays);
  bool operator==(const Answers&) const = default;
};

using Query = std::function<void(const Tree&, const std::vector<Ray>&, const QueryOptions&, Answers*)>;

const std::pair<const char*, Query> kQueries[] = {
    {"closest",
     [](auto& tree, auto& rays, auto& options, auto* out) { tree.ClosestHits(rays, options, out->closest); }},
    {"any", [](auto& tree, auto& rays, auto& options, auto* out) { tree.AnyHits(rays, options, out->any); }},
    {"all",
     [](auto& tree, auto& rays, auto& options, auto* out) {
       out->all.clear();
       tree.AllHits(rays, options, &out->all, out->all_counts);
     }},
    {"count", [](auto& tree, auto& rays, auto& options, auto* out) { tree.CountHits(rays, options, out->counts); }},
};

// `rays` look at all triangles in each of `queries`: they ask, they give the same answers for it, and they end soon
// once they are told to.
void ExpectStops(const Tree& tree, const std::vector<Ray>& rays, QueryOptions options,
                 const std::vector<size_t>& queries) {
  for (const size_t query : queries) {
    const auto& [name, run] = kQueries[query];
    SCOPED_TRACE(name);
    options.stopped = nullptr;
    Answers plain, asking;
    run(tree, rays, options, &plain);

    uint32_t asked = 0, stop_at = 0;
    const std::function<bool()> stopped = [&] { return ++asked >= stop_at && stop_at > 0; };
    options.stopped = &stopped;
    run(tree, rays, options, &asking);
    EXPECT_EQ(asking, plain);
    // A leaf has eight triangles at most, a packet 16 rays.
    EXPECT_GE(asked, 10u);
    const uint32_t in_all = asked;

    for (const uint32_t at : {1u, in_all / 2, in_all}) {
      asked = 0, stop_at = at;
      Answers cut;
      run(tree, rays, options, &cut);
      // Every step asks from then on: those that are left, of the rays in flight and of each that comes after, are few.
      EXPECT_LE(asked, at + 4 * kRays);
    }
  }
}

constexpr size_t kClosest = 0, kAny = 1, kAll = 2, kCount = 3;

void ExpectStopsBesideAll(const Tree& tree, const QueryOptions& options) {
  ExpectStops(tree, RaysDown(3.5), options, {kClosest, kAny, kAll, kCount});
}

void ExpectStopsThroughAll(const Tree& tree) {
  ExpectStops(tree, RaysDown(0.5), {}, {kAll, kCount});
  // Then all hits are sorted at once.
  ExpectStops(tree, RaysDown(0.5), {.max_hits_per_ray = kTriangles}, {kAll});
}

TEST(StopTest, BinaryTreesEndSoon) {
  const SmallScene scene = Stack();
  const BruteForce brute_force(scene.view());
  const Bvh bvh(scene.view(), MakeBvh(scene.view(), 4, 0));
  const KdTree kd_tree(scene.view(), MakeKd(scene.view(), 0));
  for (const Tree* tree :
       {static_cast<const Tree*>(&brute_force), static_cast<const Tree*>(&bvh), static_cast<const Tree*>(&kd_tree)}) {
    ExpectStopsBesideAll(*tree, {});
    ExpectStopsThroughAll(*tree);
  }
}

TEST(StopTest, WideTreesEndSoon) {
  const SmallScene scene = Stack();
  for (const SimdTarget target : SupportedSimdTargets()) {
    SCOPED_TRACE(Name(target));
    const WideTree tree = MakeWide(scene.view(), 8, 0, target);
    for (const Traversal traversal : kTraversals) {
      for (const AccuracyLevel level : kLevels) {
        SCOPED_TRACE(testing::Message() << "traversal " << static_cast<int>(traversal) << ", level "
                                        << static_cast<int>(level));
        ExpectStopsBesideAll(tree, {.accuracy = level, .traversal = traversal});
      }
    }
    ExpectStopsThroughAll(tree);
  }
}

TEST(StopTest, RaysFromVeryFarEndSoon) {
  const SmallScene scene = Stack();
  std::vector<Ray> rays = RaysDown(3.5);
  for (Ray& ray : rays) ray.origin.z = 0x1p40f, ray.direction = {0, 0, -1};
  const WideTree tree = MakeWide(scene.view(), 8, 0, SupportedSimdTargets().back());
  ExpectStops(tree, rays, {}, {kClosest, kAny, kAll, kCount});
}

}  // namespace
}  // namespace deltaray
