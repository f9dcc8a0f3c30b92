// What builds take of memory by the system's count, against what is reserved for them before they begin.

#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <vector>

#include "oneapi/tbb/task_arena.h"
#include "server/build/build.h"
#include "server/build/memory_estimate.h"
#include "server/tree/simd_target.h"
#include "tests/bench/measure.h"
#include "tests/scenes/made.h"

namespace deltaray {
namespace {

// A ray through the middle of each triangle.
std::vector<Ray> RaysAtAll(const TriangleMesh& mesh) {
  std::vector<Ray> rays;
  for (size_t i = 0; i < mesh.indices.size(); ++i) {
    const Triangle t = mesh.triangles()[static_cast<uint32_t>(i)];
    const Vec3f middle = (1 / 3.0f) * (t.v0 + t.v1 + t.v2);
    rays.push_back({.origin = {middle.x, middle.y, middle.z - 1}, .direction = {0, 0, 1}, .t_max = 2});
  }
  return rays;
}

// Has the tree of a lazy build grow until nothing is left to build.
void ReachAll(const Tree& tree, const std::vector<Ray>& rays) {
  std::vector<uint32_t> counts(rays.size());
  tbb::task_arena two(2);  // how often the tree is laid out anew goes by how many threads there are
  two.execute([&] {
    for (int pass = 0; pass < 1000 && tree.is_growing(); ++pass) tree.CountHits(rays, {}, counts);
  });
  EXPECT_FALSE(tree.is_growing());
}

TEST(BuildMemoryTest, NoBuildTakesMoreThanIsReserved) {
#ifdef DELTARAY_SANITIZED
  GTEST_SKIP() << "what a sanitizer notes beside each byte is resident too";
#endif
  struct Case {
    std::string mesh;
    Builder builder = Builder::kHybrid;
    Preset preset = Preset::kBalanced;
    uint32_t delta = 32;
    double budget = 0;  // with a gate of 0, so that it is used up
    bool lazy = false;
    SimdTarget target = SupportedSimdTargets().back();
  };
  const SimdTarget narrowest = SupportedSimdTargets().front();
  const Case cases[] = {
      {.mesh = "terrain"},
      {.mesh = "terrain", .delta = 1},
      {.mesh = "terrain", .delta = 2},
      {.mesh = "terrain", .preset = Preset::kFast, .delta = 1},
      {.mesh = "soup", .budget = 0.5},
      {.mesh = "soup", .preset = Preset::kBest, .delta = 8, .budget = 1},
      {.mesh = "soup", .builder = Builder::kBvh},
      {.mesh = "soup", .builder = Builder::kSbvh, .budget = 0.5},
      {.mesh = "soup", .builder = Builder::kKdTree, .budget = 8},
      {.mesh = "soup", .builder = Builder::kTang2015, .budget = 1},
      {.mesh = "soup", .delta = 1, .budget = 0.5},
      {.mesh = "terrain", .lazy = true},
      {.mesh = "terrain", .lazy = true, .target = narrowest},
      {.mesh = "terrain", .delta = 1, .lazy = true},
      {.mesh = "terrain", .delta = 1, .lazy = true, .target = narrowest},
      {.mesh = "soup", .budget = 0.5, .lazy = true, .target = narrowest},
  };
  const auto terrain = std::make_shared<const TriangleMesh>(Terrain(250, 200));
  const auto soup = std::make_shared<const TriangleMesh>(Soup(60'000));
  for (const Case& c : cases) {
    const std::shared_ptr<const TriangleMesh>& mesh = c.mesh == "soup" ? soup : terrain;
    Config config = MakeConfig(c.builder, c.preset);
    config.delta = c.delta;
    config.duplication_budget = c.budget;
    config.spatial_split_gate = 0;
    config.lazy = c.lazy;
    const std::vector<Ray> rays = c.lazy ? RaysAtAll(*mesh) : std::vector<Ray>();
    const PeakMemory memory;
    const auto build =
        Build::Start(mesh, {.config = config, .threads = 2, .on_delta_leaf = {}, .simd_target = c.target});
    ASSERT_TRUE(build->WaitDone().ok());
    if (c.lazy) ReachAll(*build->snapshot()->tree, rays);
    const uint64_t estimate = EstimateBuildBytes(config, mesh->indices.size());
    EXPECT_LE(memory.bytes(), estimate) << c.mesh << " delta " << c.delta << " lazy " << c.lazy << " builder "
                                        << static_cast<int>(c.builder) << " preset " << static_cast<int>(c.preset)
                                        << ' ' << Name(c.target);
    EXPECT_GE(memory.bytes(), estimate / 8) << c.mesh << ": was it measured?";
  }
}

}  // namespace
}  // namespace deltaray
