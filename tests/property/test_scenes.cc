#include "tests/property/test_scenes.h"

#include <algorithm>
#include <cmath>
#include <string_view>
#include <utility>

#include "gtest/gtest.h"
#include "server/tree/brute_force.h"
#include "tests/scenes/hard_rays.h"
#include "tests/scenes/load.h"
#include "tests/scenes/made.h"
#include "tests/scenes/pathological.h"
#include "tests/scenes/random.h"
#include "tests/scenes/rays.h"

namespace deltaray {
namespace {

#ifdef DELTARAY_SANITIZED
constexpr size_t kRays = 256, kTieRays = 64, kFewRays = 32;
#else
constexpr size_t kRays = 5376, kTieRays = 1024, kFewRays = 512;
#endif

// Fewer where a ray takes long: in the bunny, by brute force, and where much is decided exactly, since a ray meets many
// triangles at one t or since floating point cannot hold the products of coordinates.
size_t RayCount(std::string_view name) {
  for (const char* ties : {"coplanar_overlap", "geometric_series", "voxels", "ulp_layers", "needle_fan"}) {
    if (name == ties) return kTieRays;
  }
  for (const char* slow : {"bunny", "fan", "copies", "coincident", "mixed_magnitudes", "any_bits"}) {
    if (name == slow) return kFewRays;
  }
  return kRays;
}

TriangleMesh MakeMesh(const std::string& name) {
  if (name == "city") return City(6, 40);
  if (name == "soup") return Soup(600);
  if (name == "terrain") return Terrain(20, 15);
  for (const PathologicalScene& scene : PathologicalScenes()) {
    if (scene.name == name) return scene.make(scene.small_size);
  }
  absl::StatusOr<TriangleMesh> mesh = LoadScene(name);
  EXPECT_TRUE(mesh.ok()) << mesh.status();
  return mesh.ok() ? *std::move(mesh) : TriangleMesh();
}

void Append(std::vector<Ray> more, size_t most, std::vector<Ray>* rays) {
  if (more.size() > most) more.resize(most);
  rays->insert(rays->end(), more.begin(), more.end());
}

}  // namespace

std::vector<std::string> TestSceneNames() {
  std::vector<std::string> names = {"bunny", "city", "soup", "terrain"};
  for (const PathologicalScene& scene : PathologicalScenes()) names.emplace_back(scene.name);
  return names;
}

TestScene MakeTestScene(const std::string& name) {
  return {name, std::make_shared<const TriangleMesh>(MakeMesh(name)), RayCount(name)};
}

std::vector<Ray> TestRays(const TestScene& scene) {
  const TriangleMesh& mesh = *scene.mesh;
  const BruteForce tree(mesh.triangles());
  const Bounds bounds = MeshBounds(mesh);
  std::vector<Ray> rays;
  if (!mesh.indices.empty()) {
    // A twentieth for each of eleven hard families, three for rays that end at hits of those, and for common ones one
    // each, the chords all that is left.
    const size_t part = scene.ray_count / 20;
    uint64_t seed = 100;
    for (const HardRays& family : HardRayFamilies()) {
      Append(family.make(mesh, static_cast<uint32_t>(part), ++seed), part, &rays);
    }
    std::vector<Ray> sample;
    for (size_t i = 0; i < rays.size(); i += 8) sample.push_back(rays[i]);
    Append(RaysEndingAtHits(tree, sample), 3 * part, &rays);

    const auto width = static_cast<uint32_t>(std::sqrt(static_cast<double>(part)));
    const std::vector<Ray> camera = CameraRays(bounds, width, width);
    Append(camera, part, &rays);
    Append(BounceRays(mesh, tree, camera, 200), part, &rays);
    Append(ShadowRays(mesh, tree, camera), part, &rays);
  }
  Append(ChordRays(bounds, static_cast<uint32_t>(scene.ray_count), 300), scene.ray_count - rays.size(), &rays);
  Random random(400);
  for (size_t i = rays.size(); i > 1; --i) std::swap(rays[i - 1], rays[random.Below(static_cast<uint32_t>(i))]);
  return rays;
}

}  // namespace deltaray
