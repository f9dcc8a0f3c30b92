#include "server/build/auto_config.h"

#include <memory>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/build/build.h"
#include "server/tree/brute_force.h"
#include "tests/scenes/made.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

ChosenConfig ChooseFor(const TriangleMesh& mesh, const Config& wanted) {
  BuildContext context;
  const auto references = MakeReferences(mesh.triangles(), wanted.duplication_budget, context);
  EXPECT_TRUE(references.ok());
  return ChooseConfig(wanted, references->span(), context);
}

Config Auto() { return MakeConfig(Builder::kHybrid, Preset::kAuto); }

TEST(AutoConfigTest, CountsTheBoxesThatALineMeets) {
  // Two boxes, one of them the whole, the other one of half its sides.
  std::vector<Reference> references(2);
  references[0].bounds = {{0, 0, 0}, {2, 2, 2}};
  references[1].bounds = {{0, 0, 0}, {1, 1, 1}};
  BuildContext context;
  EXPECT_DOUBLE_EQ(BoxesALineMeets(references, context), 1.25);
  references[0].bounds = references[1].bounds = {{0, 0, 0}, {1, 0, 0}};
  EXPECT_EQ(BoxesALineMeets(references, context), 0);
  EXPECT_EQ(BoxesALineMeets({}, context), 0);
}

TEST(AutoConfigTest, TerrainNeedsNoSpatialSplits) {
  const ChosenConfig chosen = ChooseFor(Terrain(100, 100), Auto());
  EXPECT_EQ(chosen.config.spatial_split_gate, 1);
  EXPECT_EQ(chosen.config.duplication_budget, 0);
  EXPECT_EQ(chosen.config.delta, 32u);
  EXPECT_FALSE(chosen.config.lazy);
  EXPECT_THAT(chosen.reasons, ElementsAre(HasSubstr("no spatial splits: a line"), HasSubstr("eager: "),
                                          "delta 32, clustered: 20000 triangles are not more than 2000000"));
  EXPECT_TRUE(Validate(chosen.config).ok());
}

TEST(AutoConfigTest, CityAndSoupNeedSpatialSplits) {
  const Config balanced = MakeConfig(Builder::kHybrid, Preset::kBalanced);
  for (const TriangleMesh& mesh : {City(), Soup()}) {
    const ChosenConfig chosen = ChooseFor(mesh, Auto());
    EXPECT_EQ(chosen.config.spatial_split_gate, balanced.spatial_split_gate);
    EXPECT_EQ(chosen.config.duplication_budget, balanced.duplication_budget);
    EXPECT_EQ(chosen.reasons[0].find("spatial splits: a line"), 0u);
  }
}

TEST(AutoConfigTest, KeepsWhatWasAskedFor) {
  Config wanted = Auto();
  wanted.delta = 7;
  wanted.lazy = true;
  const ChosenConfig chosen = ChooseFor(Terrain(10, 10), wanted);
  EXPECT_EQ(chosen.config.delta, 7u);
  EXPECT_TRUE(chosen.config.lazy);
  EXPECT_EQ(chosen.reasons[1], "lazy: asked for");
  EXPECT_THAT(chosen.reasons[2], HasSubstr("delta 7 (asked for)"));
}

TEST(AutoConfigTest, LeavesOtherPresetsAndBuildersAlone) {
  for (const Config& wanted :
       {MakeConfig(Builder::kHybrid, Preset::kBest), MakeConfig(Builder::kSbvh, Preset::kAuto)}) {
    const ChosenConfig chosen = ChooseFor(City(5, 20), wanted);
    EXPECT_EQ(chosen.config.spatial_split_gate, wanted.spatial_split_gate);
    EXPECT_EQ(chosen.config.preset, wanted.preset);
    EXPECT_TRUE(chosen.reasons.empty());
  }
}

TEST(AutoConfigTest, ABuildTellsItsChoices) {
  const auto mesh = std::make_shared<const TriangleMesh>(Terrain(30, 30));
  const auto build = Build::Start(mesh, {.config = Auto(), .threads = 2, .on_delta_leaf = nullptr});
  ASSERT_TRUE(build->WaitDone().ok());
  const BuildStatistics statistics = build->statistics();
  EXPECT_EQ(statistics.config.preset, Preset::kAuto);
  EXPECT_EQ(statistics.config.delta, 32u);
  EXPECT_EQ(statistics.choices.size(), 3u);
  EXPECT_EQ(statistics.spatial_splits, 0u);
  const std::vector<Ray> rays = ChordsAndHardRays(*mesh, 200, 5);
  EXPECT_EQ(Answers(*build->snapshot()->tree, rays), Answers(BruteForce(mesh->triangles()), rays));
}

}  // namespace
}  // namespace deltaray
