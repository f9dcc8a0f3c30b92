#include "tests/oracle/certain_miss.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "gtest/gtest.h"
#include "server/mesh/triangle_mesh.h"
#include "tests/oracle/exact_hit.h"
#include "tests/scenes/hard_rays.h"
#include "tests/scenes/pathological.h"

namespace deltaray {
namespace {

// Nothing that is hit is left out, and its t is within the bounds: of every hard ray at every hard mesh.
TEST(MissFilterTest, KeepsAllThatIsHit) {
  size_t hits = 0, possibles = 0;
  for (const PathologicalScene& scene : PathologicalScenes()) {
    const TriangleMesh mesh = scene.make(std::min(scene.small_size, 60u));
    if (mesh.indices.empty()) continue;
    const MissFilter filter(mesh.triangles());
    for (const HardRays& family : HardRayFamilies()) {
      SCOPED_TRACE(testing::Message() << scene.name << ", " << family.name);
      for (const Ray& ray : family.make(mesh, 12, 3)) {
        std::vector<Possible> possible;
        filter.Find(ray, &possible);
        possibles += possible.size();
        for (uint32_t i = 0; i < mesh.indices.size(); ++i) {
          const auto hit = FindExactHit(ray, mesh.triangles()[i]);
          if (!hit) continue;
          ++hits;
          const auto found = std::ranges::find(possible, i, &Possible::primitive);
          ASSERT_NE(found, possible.end());
          EXPECT_GE(Compare(hit->t, found->t_lower), 0);
          EXPECT_LE(Compare(hit->t, found->t_upper), 0);
        }
      }
    }
  }
  EXPECT_GT(hits, 5000u);
  EXPECT_LT(possibles, 3 * hits) << "the filter spares too little";
}

}  // namespace
}  // namespace deltaray
