#include "server/build/memory_estimate.h"

#include <memory>

#include "gtest/gtest.h"
#include "server/build/build.h"
#include "tests/scenes/made.h"

namespace deltaray {
namespace {

// What a build of each preset counts itself; tests/unit/bench/build_memory_test.cc asks the system.
TEST(MemoryEstimateTest, NoBuildTakesMore) {
  for (const Builder builder :
       {Builder::kHybrid, Builder::kKdTree, Builder::kBvh, Builder::kSbvh, Builder::kTang2015}) {
    for (const Preset preset : {Preset::kFast, Preset::kBalanced, Preset::kBest, Preset::kAuto}) {
      for (const auto& mesh : {City(), Soup(20'000)}) {
        const Config config = MakeConfig(builder, preset);
        const auto build = Build::Start(std::make_shared<const TriangleMesh>(mesh),
                                        {.config = config, .threads = 2, .on_delta_leaf = {}});
        ASSERT_TRUE(build->WaitDone().ok());
        const BuildStatistics statistics = build->statistics();
        EXPECT_LE(statistics.peak_build_bytes + statistics.shape.node_bytes + statistics.shape.reference_bytes,
                  EstimateBuildBytes(config, mesh.indices.size()))
            << static_cast<int>(builder) << ' ' << static_cast<int>(preset);
      }
    }
  }
}

}  // namespace
}  // namespace deltaray
