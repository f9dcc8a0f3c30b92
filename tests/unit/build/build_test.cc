#include "server/build/build.h"

#include <chrono>
#include <cmath>
#include <cstring>
#include <ctime>
#include <limits>
#include <numeric>
#include <string>
#include <thread>
#include <tuple>

#include "gtest/gtest.h"
#include "server/build/sah.h"
#include "server/tree/bvh.h"
#include "server/tree/kd_tree.h"
#include "server/tree/wide_tree.h"
#include "tests/gate.h"
#include "tests/scenes/made.h"
#include "tests/scenes/pathological.h"
#include "tests/unit/build/builds.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

using Clock = std::chrono::steady_clock;

constexpr Builder kBuilders[] = {Builder::kHybrid, Builder::kKdTree, Builder::kBvh, Builder::kSbvh, Builder::kTang2015};

std::shared_ptr<const Tree> BuildNow(const std::shared_ptr<const TriangleMesh>& mesh, const Config& config,
                                     uint32_t threads = 2) {
  const std::shared_ptr<Build> build = Start(mesh, config, threads);
  const absl::Status status = build->WaitDone();
  EXPECT_TRUE(status.ok()) << status;
  EXPECT_TRUE(build->snapshot()->final);
  return build->snapshot()->tree;
}

template <typename Array>
bool SameBytes(const Array& a, const Array& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(*a.data())) == 0;
}

// Two trees of one builder.
void ExpectSameBytes(const Tree& a, const Tree& b) {
  if (const auto* wide = dynamic_cast<const WideTree*>(&a)) {
    const LargeArray<std::byte>& a_block = wide->arrays().block;
    const LargeArray<std::byte>& b_block = dynamic_cast<const WideTree&>(b).arrays().block;
    ASSERT_EQ(a_block.size(), b_block.size());
    EXPECT_EQ(std::memcmp(a_block.data(), b_block.data(), a_block.size()), 0);
  } else if (const auto* kd_tree = dynamic_cast<const KdTree*>(&a)) {
    EXPECT_TRUE(SameBytes(kd_tree->arrays().nodes, dynamic_cast<const KdTree&>(b).arrays().nodes));
    EXPECT_EQ(kd_tree->arrays().references, dynamic_cast<const KdTree&>(b).arrays().references);
  } else {
    const BvhArrays& a_arrays = dynamic_cast<const Bvh&>(a).arrays();
    EXPECT_TRUE(SameBytes(a_arrays.nodes, dynamic_cast<const Bvh&>(b).arrays().nodes));
    EXPECT_EQ(a_arrays.references, dynamic_cast<const Bvh&>(b).arrays().references);
  }
}

class BuildSceneTest : public testing::TestWithParam<PathologicalScene> {
 protected:
  const std::shared_ptr<const TriangleMesh> mesh_ =
      Shared(GetParam().make(std::min<uint32_t>(GetParam().full_size, 50)));
  const std::vector<Ray> rays_ = ChordsAndHardRays(*mesh_, 10, 1);
  const Answers expected_{BruteForce(mesh_->triangles()), rays_};
};

INSTANTIATE_TEST_SUITE_P(Scenes, BuildSceneTest, testing::ValuesIn(PathologicalScenes()),
                         [](const auto& info) { return std::string(info.param.name); });

TEST_P(BuildSceneTest, EveryBuilderAnswersLikeBruteForce) {
  for (const Builder builder : kBuilders) {
    const auto tree = BuildNow(mesh_, MakeConfig(builder, Preset::kBalanced));
    EXPECT_TRUE(Answers(*tree, rays_) == expected_) << static_cast<int>(builder);
  }
}

TEST_P(BuildSceneTest, EveryDeltaAndPresetAnswersLikeBruteForce) {
  for (const Preset preset : {Preset::kFast, Preset::kBest, Preset::kAuto}) {
    EXPECT_TRUE(Answers(*BuildNow(mesh_, MakeConfig(Builder::kHybrid, preset)), rays_) == expected_);
  }
  for (const uint32_t delta : {1, 8, 32, 256}) {
    for (const bool lazy : {false, true}) {
      Config config;
      config.delta = delta;
      config.lazy = lazy;
      EXPECT_TRUE(Answers(*BuildNow(mesh_, config), rays_) == expected_) << delta;
    }
  }
}

TEST_P(BuildSceneTest, AnswersAreTheSameBeforeWhileAndAfterDeltaLeavesAreBuilt) {
  Gate gate;
  gate.Close();
  const std::shared_ptr<Build> build = Start(mesh_, Config(), 2, [&] { gate.Pass(); });
  ASSERT_TRUE(build->WaitProvisional().ok());
  const auto provisional = build->snapshot();
  EXPECT_TRUE(Answers(*provisional->tree, rays_) == expected_);
  gate.Open();
  while (build->progress().phase != BuildPhase::kDone) EXPECT_TRUE(Answers(*provisional->tree, rays_) == expected_);
  ASSERT_TRUE(build->WaitDone().ok());
  EXPECT_TRUE(build->snapshot()->final);
  EXPECT_TRUE(Answers(*build->snapshot()->tree, rays_) == expected_);
  // The old snapshot lives as long as it is held.
  EXPECT_TRUE(Answers(*provisional->tree, rays_) == expected_);
}

TEST(BuildTest, RaysAreAnsweredBeforeTheFirstDeltaLeafIsBuilt) {
  const auto mesh = Shared(City(20, 100));
  Gate gate;
  gate.Close();
  const std::shared_ptr<Build> build = Start(mesh, Config(), 2, [&] { gate.Pass(); });
  ASSERT_TRUE(build->WaitProvisional().ok());
  ASSERT_FALSE(build->snapshot()->final);
  const std::vector<Ray> rays = ChordRays(MeshBounds(*mesh), 200, 1);
  const Answers before(*build->snapshot()->tree, rays);
  EXPECT_EQ(build->progress().delta_leaves_built, 0u);
  EXPECT_EQ(build->statistics().total_seconds, 0);
  EXPECT_GT(build->statistics().provisional_seconds, 0);
  gate.Open();
  ASSERT_TRUE(build->WaitDone().ok());
  EXPECT_TRUE(Answers(*build->snapshot()->tree, rays) == before);
}

class BuildBuilderTest : public testing::TestWithParam<Builder> {};

std::string NameOf(const testing::TestParamInfo<Builder>& info) {
  constexpr const char* kNames[] = {"Hybrid", "KdTree", "Bvh", "Sbvh", "Tang2015"};
  return kNames[static_cast<size_t>(info.param)];
}
INSTANTIATE_TEST_SUITE_P(Builders, BuildBuilderTest, testing::ValuesIn(kBuilders), NameOf);

TEST_P(BuildBuilderTest, GivesTheSameBytesForAnyNumberOfThreads) {
  const auto mesh = Shared(Soup(10'000));
  const Config config = MakeConfig(GetParam(), Preset::kBalanced);
  const auto one = BuildNow(mesh, config, 1);
  for (const uint32_t threads : {2, 4}) {
    const auto more = BuildNow(mesh, config, threads);
    ExpectSameBytes(*one, *more);
  }
}

TEST_P(BuildBuilderTest, CityStaysWithinItsBudget) {
  const auto mesh = Shared(City(30, 800));
  const Config config = MakeConfig(GetParam(), Preset::kBalanced);
  const std::shared_ptr<Build> build = Start(mesh, config);
  ASSERT_TRUE(build->WaitDone().ok());
  const BuildStatistics statistics = build->statistics();
  EXPECT_EQ(statistics.triangles, mesh->indices.size());
  EXPECT_GE(statistics.shape.references, statistics.triangles);
  EXPECT_LE(statistics.shape.references, (1 + config.duplication_budget) * static_cast<double>(mesh->indices.size()));
}

TEST_P(BuildBuilderTest, TellsWhatItDid) {
  const auto mesh = Shared(Soup(5000));
  const std::shared_ptr<Build> build = Start(mesh, MakeConfig(GetParam(), Preset::kBalanced), 3);
  ASSERT_TRUE(build->WaitDone().ok());
  const BuildStatistics s = build->statistics();
  EXPECT_EQ(s.config.builder, GetParam());
  EXPECT_EQ(s.threads, 3u);
  EXPECT_EQ(s.triangles, 5000u);
  EXPECT_GT(s.total_seconds, 0);
  EXPECT_GT(s.provisional_seconds, 0);
  EXPECT_LE(s.provisional_seconds, s.total_seconds);
  EXPECT_GE(s.peak_build_bytes, 5000 * sizeof(Reference));
  EXPECT_GT(s.shape.sah_cost, 0);
  EXPECT_GT(s.shape.nodes, s.shape.leaves);
  EXPECT_GT(s.spatial_splits + s.object_splits, 0u);
  double wall_seconds = 0;
  for (const PhaseTime& phase : s.phases) {
    wall_seconds += phase.wall_seconds;
    EXPECT_GT(phase.cpu_seconds, 0);
  }
  EXPECT_GT(wall_seconds, 0);
  EXPECT_LE(wall_seconds, s.total_seconds);
  EXPECT_EQ(s.delta_leaves_built, s.delta_leaves);
  EXPECT_EQ(std::accumulate(s.delta_leaf_size_histogram.begin(), s.delta_leaf_size_histogram.end(), uint64_t{0}),
            s.delta_leaves);
  const bool has_delta_leaves = GetParam() == Builder::kHybrid || GetParam() == Builder::kTang2015;
  EXPECT_EQ(s.delta_leaves > 0, has_delta_leaves);
  if (GetParam() == Builder::kHybrid) {
    EXPECT_EQ(std::accumulate(s.candidate_wins.begin(), s.candidate_wins.end(), uint64_t{0}), s.delta_leaves);
  }

  const BuildProgress progress = build->progress();
  EXPECT_EQ(progress.phase, BuildPhase::kDone);
  EXPECT_EQ(progress.triangles, 5000u);
  EXPECT_GE(progress.references_placed, 5000u);
  EXPECT_EQ(progress.elapsed_seconds, s.total_seconds);
}

// Sanitizers slow down what a builder does between two looks at whether it is cancelled, and all else.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
constexpr double kSoonSeconds = 1;
constexpr uint32_t kCancelledSide = 200;
#else
constexpr double kSoonSeconds = 0.1;
constexpr uint32_t kCancelledSide = 400;
#endif

// At moments all through a build, in processor time, since other work on the machine may delay any build; and at each
// by the quickest of some tries.
TEST_P(BuildBuilderTest, IsCancelledWithin100Milliseconds) {
  static const auto mesh = Shared(Terrain(kCancelledSide, kCancelledSide));
  const Config config = MakeConfig(GetParam(), Preset::kBest);
  const auto whole_start = Clock::now();
  BuildNow(mesh, config);
  const auto whole = Clock::now() - whole_start;
  for (int fifths = 0; fifths < 5; ++fifths) {
    double least = std::numeric_limits<double>::infinity();
    for (int tries = 0; tries < 5 && least >= kSoonSeconds; ++tries) {
      const std::shared_ptr<Build> build = Start(mesh, config);
      std::this_thread::sleep_for(fifths * whole / 5);
      const std::clock_t start = std::clock();
      build->Cancel();
      const absl::Status status = build->WaitDone();
      least = std::min(least, static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC);
      // One that got more of the machine than the first may be done.
      if (status.ok() && fifths > 0) continue;
      EXPECT_EQ(status.code(), absl::StatusCode::kCancelled);
      EXPECT_TRUE(build->snapshot() == nullptr || !build->snapshot()->final);
    }
    EXPECT_LT(least, kSoonSeconds) << fifths << " fifths through the build";
  }
}

// A power of two scales every number without rounding.
TEST_P(BuildBuilderTest, ScalingTheMeshScalesTheTree) {
  const TriangleMesh mesh = Soup(3000);
  // Printed, [Tang 2015] adds areas relative to the mesh to distances that are not.
  if (GetParam() == Builder::kTang2015) GTEST_SKIP() << "depends on the mesh's unit by design";
  const Config config = MakeConfig(GetParam(), Preset::kBalanced);
  const auto tree = BuildNow(Shared(mesh), config);
  for (const int exponent : {-90, -40, 7, 60, 90}) {
    TriangleMesh scaled = mesh;
    for (Vec3f& position : scaled.positions) position = std::ldexp(1.0f, exponent) * position;
    const auto scaled_tree = BuildNow(Shared(scaled), config);
    EXPECT_EQ(tree->Shape().sah_cost, scaled_tree->Shape().sah_cost);
    if (GetParam() == Builder::kKdTree) {
      const auto& arrays = dynamic_cast<const KdTree&>(*tree).arrays();
      EXPECT_EQ(arrays.references, dynamic_cast<const KdTree&>(*scaled_tree).arrays().references);
      continue;
    }
    // The wide tree's frame takes the scale out.
    ExpectSameBytes(*tree, *scaled_tree);
  }
}

TEST(BuildTest, TheHybridIsAsGoodAsTheSbvh) {
  for (const auto& mesh : {Shared(City(90, 2400)), Shared(Soup(50'000))}) {
    const double hybrid = BuildNow(mesh, Config())->Shape().sah_cost;
    const double sbvh = BuildNow(mesh, MakeConfig(Builder::kSbvh, Preset::kBalanced))->Shape().sah_cost;
    EXPECT_LE(hybrid, 1.03 * sbvh);
  }
}

TEST(BuildTest, LazyDeltaLeavesAreBuiltAsRaysReachThem) {
  const auto mesh = Shared(Terrain(60, 60));
  Config config;
  config.lazy = true;
  std::shared_ptr<const TreeSnapshot> snapshot;
  std::vector<Ray> rays = CameraRays(MeshBounds(*mesh), 20, 20);
  const Answers expected(BruteForce(mesh->triangles()), rays);
  {
    const std::shared_ptr<Build> build = Start(mesh, config);
    ASSERT_TRUE(build->WaitDone().ok());
    snapshot = build->snapshot();
    EXPECT_TRUE(snapshot->final);
    EXPECT_EQ(build->progress().delta_leaves_built, 0u);

    // One ray reaches few of them.
    std::vector<Hit> hits(1);
    snapshot->tree->ClosestHits(std::span(rays).subspan(210, 1), {}, hits);
    const uint64_t reached = build->progress().delta_leaves_built;
    EXPECT_GT(reached, 0u);
    EXPECT_LT(reached, build->progress().delta_leaves / 2);
    const BuildStatistics statistics = build->statistics();
    EXPECT_EQ(statistics.delta_leaves_built, reached);
    EXPECT_EQ(std::accumulate(statistics.candidate_wins.begin(), statistics.candidate_wins.end(), uint64_t{0}),
              reached);
    EXPECT_EQ(statistics.phases.size(), 3u);  // references, top, δ-leaves so far
    EXPECT_GT(statistics.total_seconds, 0);
  }
  // The build is gone; the tree goes on, from many threads.
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i) {
    threads.emplace_back([&] { EXPECT_TRUE(Answers(*snapshot->tree, rays) == expected); });
  }
  for (std::thread& thread : threads) thread.join();
}

}  // namespace
}  // namespace deltaray
