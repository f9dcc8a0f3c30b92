#include "tests/bench/ray_sets.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "tests/scenes/rays.h"

namespace deltaray {
namespace {
constexpr uint64_t kSeed = 1;
}  // namespace

std::vector<std::string> RaySetNames() { return {"camera", "bounce", "chords", "shadow", "miss"}; }

absl::StatusOr<RaySet> MakeRaySet(std::string_view name, const TriangleMesh& mesh, const Tree& tree, uint32_t size) {
  const Bounds bounds = MeshBounds(mesh);
  RaySet set;
  set.name = name;
  if (name == "chords" || name == "miss") {
    set.rays = ChordRays(bounds, size * size, kSeed);
    if (name == "miss") {
      for (Ray& ray : set.rays) ray.direction = -1.0f * ray.direction;
    }
    return set;
  }
  set.rays = CameraRays(bounds, size, size);
  if (name == "camera") {
    set.coherent = true;
  } else if (name == "bounce") {
    set.rays = BounceRays(mesh, tree, set.rays, kSeed);
  } else if (name == "shadow") {
    set.question = Question::kAnyHit;
    set.coherent = true;
    set.rays = ShadowRays(mesh, tree, set.rays);
  } else {
    return absl::InvalidArgumentError(
        absl::StrCat("no rays '", std::string(name), "'; there are ", absl::StrJoin(RaySetNames(), ", ")));
  }
  return set;
}

}  // namespace deltaray
