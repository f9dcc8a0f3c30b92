#include "tests/bench/ray_sets.h"

#include <algorithm>

#include "gtest/gtest.h"
#include "server/tree/brute_force.h"
#include "tests/scenes/made.h"

namespace deltaray {
namespace {

class RaySetsTest : public testing::Test {
 protected:
  RaySet Make(std::string_view name) {
    absl::StatusOr<RaySet> set = MakeRaySet(name, mesh_, tree_, 32);
    EXPECT_TRUE(set.ok()) << set.status();
    return *std::move(set);
  }

  size_t CountHits(const std::vector<Ray>& rays) {
    std::vector<Hit> hits(rays.size());
    tree_.ClosestHits(rays, {}, hits);
    return std::count_if(hits.begin(), hits.end(), [](const Hit& hit) { return hit.IsHit(); });
  }

  const TriangleMesh mesh_ = City(6, 10);
  const BruteForce tree_{mesh_.triangles()};
};

TEST_F(RaySetsTest, SecondaryRaysStartAtTheHitsOfTheCamera) {
  const RaySet camera = Make("camera");
  EXPECT_EQ(camera.rays.size(), 32u * 32u);
  EXPECT_TRUE(camera.coherent);
  const size_t hits = CountHits(camera.rays);
  EXPECT_GT(hits, 0u);
  const RaySet bounce = Make("bounce");
  EXPECT_EQ(bounce.rays.size(), hits);
  EXPECT_FALSE(bounce.coherent);
  EXPECT_EQ(bounce.question, Question::kClosestHit);
  const RaySet shadow = Make("shadow");
  EXPECT_EQ(shadow.rays.size(), hits);
  EXPECT_EQ(shadow.question, Question::kAnyHit);
}

TEST_F(RaySetsTest, ChordsCrossTheSphereAndMissesLeaveIt) {
  EXPECT_EQ(Make("chords").rays.size(), 32u * 32u);
  EXPECT_GT(CountHits(Make("chords").rays), 0u);
  EXPECT_EQ(Make("miss").rays.size(), 32u * 32u);
  EXPECT_EQ(CountHits(Make("miss").rays), 0u);
}

TEST_F(RaySetsTest, NamesThatAreNoSetAreRefused) {
  for (const std::string& name : RaySetNames()) EXPECT_EQ(Make(name).name, name);
  EXPECT_EQ(MakeRaySet("x-rays", mesh_, tree_, 32).status(),
            absl::InvalidArgumentError("no rays 'x-rays'; there are camera, bounce, chords, shadow, miss"));
}

}  // namespace
}  // namespace deltaray
