// Rays are answered while the build runs, with the same bits as after it.

#include <algorithm>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_format.h"
#include "gtest/gtest.h"
#include "server/build/build.h"
#include "tests/property/gated_build.h"
#include "tests/property/reference_answers.h"
#include "tests/property/test_scenes.h"
#include "tests/scenes/load.h"
#include "tests/scenes/made.h"
#include "tests/scenes/rays.h"

namespace deltaray {
namespace {

class EarlyAnswersTest : public testing::TestWithParam<std::string> {};

INSTANTIATE_TEST_SUITE_P(Scenes, EarlyAnswersTest, testing::ValuesIn(TestSceneNames()),
                         [](const auto& info) { return info.param; });

TEST_P(EarlyAnswersTest, AnswersAsBruteForceWhileDeltaLeavesAreBuilt) {
  const TestScene scene = MakeTestScene(GetParam());
  const ReferenceAnswers answers(scene.mesh->triangles(), TestRays(scene));
  size_t first = 0;
  for (const Builder builder : {Builder::kHybrid, Builder::kTang2015}) {
    for (const uint32_t delta : {1, 8, 32, 256}) {
      for (const uint32_t threads : {1, 2}) {
        SCOPED_TRACE(absl::StrFormat("builder %d, delta %d, %d threads", static_cast<int>(builder), delta, threads));
        Config config = MakeConfig(builder, Preset::kBalanced);
        config.delta = delta;
        GatedBuild gated(scene.mesh, config, threads);
        Build& build = *gated.build;
        ASSERT_TRUE(build.WaitProvisional().ok());
        constexpr size_t kStride = 8;

        const uint64_t leaves = build.progress().delta_leaves;
        if (leaves > 1) {
          const std::shared_ptr<const TreeSnapshot> provisional = build.snapshot();
          EXPECT_FALSE(provisional->final);
          EXPECT_TRUE(answers.Match(*provisional->tree, first++ % kStride, kStride)) << "no leaf built";
          gated.Advance(leaves / 2);
          EXPECT_TRUE(answers.Match(*provisional->tree, first++ % kStride, kStride)) << "half of the leaves built";
        }
        gated.turnstile->Let(kAllLeaves);
        ASSERT_TRUE(build.WaitDone().ok());
        EXPECT_TRUE(build.snapshot()->final);
        EXPECT_TRUE(answers.Match(*build.snapshot()->tree, first++ % kStride, kStride)) << "all leaves built";
      }
    }
  }
}

// The dragon where it was fetched, else a terrain.
std::shared_ptr<const TriangleMesh> LargeMesh() {
  absl::StatusOr<TriangleMesh> dragon = LoadScene("dragon");
  return std::make_shared<const TriangleMesh>(dragon.ok() ? *std::move(dragon) : Terrain(300, 300));
}

TEST(EarlyAnswersTest, AnswersAPictureBeforeAnyDeltaLeafIsBuiltWithTheBitsOfTheFinalTree) {
  const std::shared_ptr<const TriangleMesh> mesh = LargeMesh();
  const std::vector<Ray> rays = CameraRays(MeshBounds(*mesh), 64, 48);
  GatedBuild gated(mesh, Config(), 2);
  ASSERT_TRUE(gated.build->WaitProvisional().ok());
  const std::shared_ptr<const TreeSnapshot> early = gated.build->snapshot();
  ASSERT_FALSE(early->final);
  std::vector<Hit> early_hits(rays.size());
  early->tree->ClosestHits(rays, {}, early_hits);
  EXPECT_EQ(gated.build->progress().delta_leaves_built, 0u);
  EXPECT_GT(gated.build->progress().delta_leaves, 1000u);

  gated.turnstile->Let(kAllLeaves);
  ASSERT_TRUE(gated.build->WaitDone().ok());
  const std::shared_ptr<const TreeSnapshot> late = gated.build->snapshot();
  ASSERT_TRUE(late->final);
  std::vector<Hit> late_hits(rays.size());
  late->tree->ClosestHits(rays, {}, late_hits);
  EXPECT_EQ(early_hits, late_hits);
  EXPECT_NE(std::count_if(late_hits.begin(), late_hits.end(), [](const Hit& hit) { return hit.IsHit(); }), 0);
}

// Traces without a pause, while δ-leaves are built, an eighth of them from one round to the next, and the final tree
// replaces the provisional one.
TEST(EarlyAnswersTest, TracesWhileLeavesArePublished) {
  const auto mesh = std::make_shared<const TriangleMesh>(Terrain(60, 60));
  const std::vector<Ray> rays = ChordRays(MeshBounds(*mesh), 2000, 1);
  GatedBuild gated(mesh, Config(), 2);
  ASSERT_TRUE(gated.build->WaitProvisional().ok());
  const uint64_t eighth = gated.build->progress().delta_leaves / 8;
  ASSERT_GT(eighth, 0u);
  std::vector<Hit> first(rays.size()), again(rays.size());
  gated.build->snapshot()->tree->ClosestHits(rays, {}, first);
  size_t early_rounds = 0;
  while (true) {
    gated.turnstile->Let(eighth);
    const std::shared_ptr<const TreeSnapshot> snapshot = gated.build->snapshot();
    snapshot->tree->ClosestHits(rays, {}, again);
    ASSERT_EQ(first, again);
    if (snapshot->final) break;
    ++early_rounds;
  }
  EXPECT_GE(early_rounds, 7u);
}

// A lazy build makes only the leaves that rays reach, and answers the same.
TEST(EarlyAnswersTest, LazyBuildsOnlyWhatRaysReach) {
  const auto mesh = std::make_shared<const TriangleMesh>(Terrain(100, 100));
  const std::vector<Ray> rays = ChordRays(MeshBounds(*mesh), 400, 1);
  const ReferenceAnswers answers(mesh->triangles(), rays);
  Build::Options options;
  options.config.lazy = true;
  const std::shared_ptr<Build> build = Build::Start(mesh, options);
  ASSERT_TRUE(build->WaitDone().ok());
  const uint64_t leaves = build->progress().delta_leaves;
  EXPECT_EQ(build->progress().delta_leaves_built, 0u);

  std::vector<Hit> hit(1);
  const auto found = std::find_if(rays.begin(), rays.end(), [&](const Ray& ray) {
    build->snapshot()->tree->ClosestHits({&ray, 1}, {}, hit);
    return hit[0].IsHit();
  });
  ASSERT_NE(found, rays.end());
  const uint64_t after_one_hit = build->progress().delta_leaves_built;
  EXPECT_GT(after_one_hit, 0u);
  EXPECT_LT(after_one_hit, leaves / 2);

  EXPECT_TRUE(answers.Match(*build->snapshot()->tree)) << "while leaves are built";
  EXPECT_GT(build->progress().delta_leaves_built, after_one_hit);
  EXPECT_TRUE(answers.Match(*build->snapshot()->tree)) << "once they are";
}

}  // namespace
}  // namespace deltaray
