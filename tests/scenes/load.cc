#include "tests/scenes/load.h"

#include <fstream>
#include <iterator>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "server/mesh/read_mesh.h"
#include "tests/scenes/made.h"
#include "tests/scenes/pathological.h"

namespace deltaray {
namespace {

constexpr std::string_view kBunny = "/usr/share/glmark2/models/bunny.obj";
// The directory is defined by CMake.
constexpr std::string_view kDragon = DELTARAY_SCENE_CACHE "/dragon_vrip.ply";
constexpr std::string_view kElephant = DELTARAY_SCENE_CACHE "/elephant.obj";
constexpr std::string_view kArmadillo = DELTARAY_SCENE_CACHE "/armadillo.obj";

absl::StatusOr<TriangleMesh> ReadFile(std::string_view path, std::string_view advice) {
  std::ifstream file(std::string(path), std::ios::binary);
  if (!file) return absl::NotFoundError(absl::StrCat(std::string(path), " is missing: ", std::string(advice)));
  const std::vector<char> bytes{std::istreambuf_iterator<char>(file), {}};
  absl::StatusOr<ReadMeshResult> result = ReadMesh(bytes, {});
  if (!result.ok()) return result.status();
  return std::move(result->mesh);
}

}  // namespace

std::vector<std::string> SceneNames() {
  std::vector<std::string> names = {"bunny", "dragon", "elephant", "armadillo", "city", "soup", "terrain"};
  for (const PathologicalScene& scene : PathologicalScenes()) names.emplace_back(scene.name);
  return names;
}

absl::StatusOr<TriangleMesh> LoadScene(std::string_view name) {
  if (name == "bunny") return ReadFile(kBunny, "install Debian's package glmark2-data");
  if (name == "dragon") return ReadFile(kDragon, "run tests/bench/fetch_dragon.sh");
  if (name == "elephant") return ReadFile(kElephant, "run tests/bench/fetch_elephant.sh");
  if (name == "armadillo") return ReadFile(kArmadillo, "run tests/bench/fetch_elephant.sh");
  if (name == "city") return City();
  if (name == "soup") return Soup();
  if (name == "terrain") return Terrain(1000, 1000);
  for (const PathologicalScene& scene : PathologicalScenes()) {
    if (name == scene.name) return scene.make(scene.full_size);
  }
  return absl::InvalidArgumentError(
      absl::StrCat("no scene '", std::string(name), "'; there are ", absl::StrJoin(SceneNames(), ", ")));
}

}  // namespace deltaray
