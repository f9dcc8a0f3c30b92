// Bundles of rays around hard ones: packets answer them as brute force does, bit for bit.

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "gtest/gtest.h"
#include "server/build/build.h"
#include "server/tree/brute_force.h"
#include "server/tree/wide_tree.h"
#include "tests/property/packet_count.h"
#include "tests/property/reference_answers.h"
#include "tests/property/test_scenes.h"
#include "tests/scenes/hard_rays.h"
#include "tests/scenes/random.h"
#include "tests/scenes/rays.h"

namespace deltaray {
namespace {

// A ray near `hard`: each origin's coordinate within `spread` of the mesh's size, each direction's component within
// that part of itself, so that they go to the same sides; some are not moved at all.
Ray Near(const Ray& hard, double size, double spread, Random* random) {
  Ray ray = hard;
  for (int axis = 0; axis < 3; ++axis) {
    const auto moved = [&](double x, double scale) {
      const auto near = static_cast<float>(x + scale * spread * random->Uniform(-1, 1));
      return random->Below(3) == 0 || std::isinf(near) ? static_cast<float>(x) : near;
    };
    ray.origin[axis] = moved(hard.origin[axis], size);
    ray.direction[axis] = moved(hard.direction[axis], hard.direction[axis]);
  }
  return ray;
}

// Gives two rays of three an interval that begins or ends at, or just short of, the hit that they have, or excludes it.
void Restrict(const Hit& hit, Random* random, Ray* ray) {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  switch (random->Below(hit.IsHit() ? 9 : 4)) {
    case 3:
      ray->t_min = -kInfinity;
      break;
    case 4:
      ray->t_max = hit.t;
      break;
    case 5:
      ray->t_max = std::nextafter(hit.t, -kInfinity);
      break;
    case 6:
      ray->t_min = hit.t;
      break;
    case 7:
      ray->t_min = std::nextafter(hit.t, kInfinity);
      break;
    case 8:
      ray->excluded_primitive = hit.primitive;
      break;
    default:
      break;
  }
}

// Bundles of 16, 32 or 48 rays around one ray of each hard family in turn, half as many rays as the scene has.
std::vector<Ray> Bundles(const TestScene& scene) {
  const TriangleMesh& mesh = *scene.mesh;
  const Bounds bounds = MeshBounds(mesh);
  const auto size = static_cast<double>(bounds.max[bounds.WidestAxis()]) - bounds.min[bounds.WidestAxis()];
  const size_t count = scene.ray_count / 2;
  std::vector<std::vector<Ray>> families;
  for (const HardRays& family : HardRayFamilies()) {
    families.push_back(family.make(mesh, static_cast<uint32_t>(count / kRaysOfPacket + 1), 600 + families.size()));
  }
  Random random(500);
  std::vector<Ray> rays;
  for (size_t bundle = 0; rays.size() < count; ++bundle) {
    const Ray& hard = families[bundle % families.size()][bundle / families.size()];
    constexpr int kSpreads[] = {-12, -16, -20, -23, -24, -30};
    const double spread = std::ldexp(1.0, kSpreads[random.Below(std::size(kSpreads))]);
    for (size_t i = (1 + random.Below(3)) * kRaysOfPacket; i > 0; --i) {
      rays.push_back(Near(hard, size, spread, &random));
    }
  }
  std::vector<Hit> hits(rays.size());
  BruteForce(mesh.triangles()).ClosestHits(rays, {}, hits);
  for (size_t i = 0; i < rays.size(); ++i) Restrict(hits[i], &random, &rays[i]);
  return rays;
}

class BundlesTest : public testing::TestWithParam<std::string> {};

std::vector<std::string> ScenesWithTriangles() {
  std::vector<std::string> names = TestSceneNames();
  std::erase_if(names, [](const std::string& name) { return MakeTestScene(name).mesh->indices.empty(); });
  return names;
}

INSTANTIATE_TEST_SUITE_P(Scenes, BundlesTest, testing::ValuesIn(ScenesWithTriangles()),
                         [](const auto& info) { return info.param; });

TEST_P(BundlesTest, PacketsAnswerAsBruteForce) {
  const TestScene scene = MakeTestScene(GetParam());
  const ReferenceAnswers answers(scene.mesh->triangles(), Bundles(scene));
  for (const SimdTarget target : SupportedSimdTargets()) {
    SCOPED_TRACE(Name(target));
    const auto build = Build::Start(scene.mesh, {MakeConfig(Builder::kHybrid, Preset::kBalanced), 2, nullptr, target});
    const absl::Status status = build->WaitDone();
    ASSERT_TRUE(status.ok()) << status;
    const std::shared_ptr<const TreeSnapshot> snapshot = build->snapshot();
    const auto* const tree = dynamic_cast<const WideTree*>(snapshot->tree.get());
    ASSERT_NE(tree, nullptr);
    for (const Traversal traversal : {Traversal::kPacket, Traversal::kAuto}) {
      SCOPED_TRACE(traversal == Traversal::kPacket ? "packets" : "auto");
      EXPECT_TRUE(answers.Match(*tree, 0, 1, traversal));
      // Else this tests little.
      const size_t packets = CountPackets(answers.rays(), tree->arrays(), traversal == Traversal::kPacket);
      EXPECT_GE(2 * packets * kRaysOfPacket, answers.rays().size());
    }
  }
}

}  // namespace
}  // namespace deltaray
