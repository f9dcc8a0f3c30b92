// Every structure, however it was built, gives brute force's answers, bit for bit.

#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/str_format.h"
#include "gtest/gtest.h"
#include "server/build/build.h"
#include "tests/property/reference_answers.h"
#include "tests/property/test_scenes.h"

namespace deltaray {
namespace {

// Of the rays that a structure which differs in little from another one is asked, one in so many.
constexpr size_t kStride = 4;

std::shared_ptr<const TreeSnapshot> BuildToEnd(const TestScene& scene, const Config& config, uint32_t threads,
                                               std::optional<SimdTarget> simd_target = std::nullopt) {
  const std::shared_ptr<Build> build = Build::Start(scene.mesh, {config, threads, nullptr, simd_target});
  const absl::Status status = build->WaitDone();
  EXPECT_TRUE(status.ok()) << status;
  return build->snapshot();
}

class AnswersTest : public testing::TestWithParam<std::string> {};

INSTANTIATE_TEST_SUITE_P(Scenes, AnswersTest, testing::ValuesIn(TestSceneNames()),
                         [](const auto& info) { return info.param; });

TEST_P(AnswersTest, EveryStructureAnswersAsBruteForce) {
  const TestScene scene = MakeTestScene(GetParam());
  const ReferenceAnswers answers(scene.mesh->triangles(), TestRays(scene));
  ASSERT_EQ(answers.rays().size(), scene.ray_count);

  const auto check = [&](Config config, uint32_t threads, size_t first, size_t stride) {
    SCOPED_TRACE(absl::StrFormat("builder %d, delta %d, %d threads%s", static_cast<int>(config.builder), config.delta,
                                 threads, config.lazy ? ", lazy" : ""));
    const std::shared_ptr<const TreeSnapshot> snapshot = BuildToEnd(scene, config, threads);
    ASSERT_NE(snapshot, nullptr);
    EXPECT_TRUE(answers.Match(*snapshot->tree, first, stride));
  };
  for (const Builder builder : {Builder::kKdTree, Builder::kBvh, Builder::kSbvh}) {
    check(MakeConfig(builder, Preset::kBalanced), 1, 0, 1);
    check(MakeConfig(builder, Preset::kBalanced), 2, 0, kStride);
  }
  for (const Builder builder : {Builder::kHybrid, Builder::kTang2015}) {
    size_t first = 0;
    for (const uint32_t delta : {1, 8, 32, 256}) {
      Config config = MakeConfig(builder, Preset::kBalanced);
      config.delta = delta;
      // All rays for the default, and a quarter, another one each time, for the others.
      check(config, 1, delta == 32 ? 0 : first, delta == 32 ? 1 : kStride);
      check(config, 2, first, kStride);
      if (builder == Builder::kHybrid) {
        config.lazy = true;
        check(config, 2, first, kStride);
      }
      ++first;
    }
  }
  // Trees of every width, and every way through them.
  for (const SimdTarget target : SupportedSimdTargets()) {
    SCOPED_TRACE(Name(target));
    const auto snapshot = BuildToEnd(scene, MakeConfig(Builder::kHybrid, Preset::kBalanced), 2, target);
    ASSERT_NE(snapshot, nullptr);
    size_t first = 0;
    for (const Traversal traversal :
         {Traversal::kAuto, Traversal::kSingle, Traversal::kBatch, Traversal::kPacket, Traversal::kStream}) {
      EXPECT_TRUE(answers.Match(*snapshot->tree, first++, kStride, traversal)) << static_cast<int>(traversal);
    }
  }
}

TEST(AnswersTest, TheRaysAreMoreThanAHundredThousand) {
#ifdef DELTARAY_SANITIZED
  GTEST_SKIP() << "under sanitizers there are fewer";
#endif
  size_t rays = 0;
  for (const std::string& name : TestSceneNames()) rays += MakeTestScene(name).ray_count;
  EXPECT_GE(rays, 100'000u);
}

}  // namespace
}  // namespace deltaray
