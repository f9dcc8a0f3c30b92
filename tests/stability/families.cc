#include "tests/stability/families.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "server/build/build.h"
#include "tests/scenes/hard_rays.h"
#include "tests/scenes/load.h"
#include "tests/scenes/made.h"
#include "tests/scenes/pathological.h"
#include "tests/scenes/rays.h"

namespace deltaray {
namespace {

// A made scene of LoadScene is taken whole where `size` is 0, else made smaller.
struct Row {
  std::string_view name, scene;
  uint32_t size;
  std::string_view rays;  // a hard family, or one of MakeRays
};

constexpr Row kRows[] = {
    // As in use.
    {"scan_camera", "bunny", 0, "camera"},
    {"scan_chords", "bunny", 0, "chords"},
    {"scan_bounce", "bunny", 0, "bounce"},
    {"city_chords", "city", 30, "chords"},
    {"soup_chords", "soup", 20'000, "chords"},
    // Vertices and edges.
    {"scan_vertices", "bunny", 0, "at_vertices"},
    {"sphere_vertices", "sphere", 0, "at_vertices"},
    {"sphere_edges", "sphere", 0, "at_edges"},
    {"grid_vertices", "integer_grid", 0, "at_vertices"},
    {"grid_edges", "integer_grid", 0, "at_edges"},
    {"t_junctions", "t_junctions", 0, "at_edges"},
    {"ulp_cracks", "ulp_cracks", 0, "at_edges"},
    {"fan", "fan", 0, "chords"},
    {"fan_centre", "fan", 60, "at_vertices"},
    {"needle_fan", "needle_fan", 0, "at_edges"},
    {"slivers", "slivers", 0, "at_edges"},
    // Rays in planes.
    {"box_faces", "voxels", 0, "along_axes"},
    {"box_planes", "voxels", 0, "in_axis_planes"},
    {"nearly_along_axes", "voxels", 0, "nearly_along_axes"},
    {"nested_boxes", "nested_boxes", 0, "along_axes"},
    {"kd_planes_in_flat_geometry", "flat_grid", 0, "along_axes"},
    {"coplanar_neighbours", "flat_grid", 0, "at_edges"},
    {"inside_faces", "integer_grid", 0, "in_planes"},
    {"grazing", "soup", 20'000, "in_planes"},
    // Triangles in one place.
    {"coplanar_overlap", "coplanar_overlap", 100, "at_edges"},
    {"coincident", "coincident", 0, "chords"},
    {"coincident_pairs", "voxels", 0, "at_vertices"},
    {"ulp_layers", "ulp_layers", 0, "chords"},
    // Sizes and places.
    {"from_afar", "sphere", 0, "from_afar"},
    {"from_afar_at_scan", "bunny", 0, "from_afar"},
    {"mesh_1e4_away", "distant", 0, "at_vertices"},
    {"mesh_1e7_away", "far_from_origin", 0, "at_edges"},
    {"teapot_in_stadium", "teapot_in_stadium", 0, "at_vertices"},
    {"huge_among_tiny", "huge_among_tiny", 0, "chords"},
    {"huge_and_tiny", "geometric_series", 0, "from_surface"},
    {"tiny", "tiny", 0, "at_vertices"},
    {"huge", "huge", 0, "at_vertices"},
    {"denormal", "denormal", 0, "at_vertices"},
    {"mixed_magnitudes", "mixed_magnitudes", 80, "from_surface"},
    {"any_bits", "any_bits", 100, "of_any_bits"},
    {"all_speeds", "sphere", 0, "at_all_speeds"},
    // Intervals.
    {"ending_at_hits", "sphere", 0, "ending_at_hits"},
    {"ending_at_exact_hits", "integer_grid", 0, "ending_at_hits"},
    {"odd_intervals", "integer_grid", 0, "odd_intervals"},
    {"from_surface", "bunny", 0, "from_surface"},
    {"from_exact_surface", "integer_grid", 0, "from_surface"},
    // Triangles that are none.
    {"half_degenerate", "half_degenerate", 0, "from_surface"},
    {"all_degenerate", "all_degenerate", 0, "at_edges"},
    {"single", "single", 0, "at_edges"},
    {"empty", "empty", 0, "chords"},
};

absl::StatusOr<TriangleMesh> MakeMesh(const Row& row) {
  if (row.size == 0) return LoadScene(row.scene);
  if (row.scene == "city") return City(row.size, 10 * row.size);
  if (row.scene == "soup") return Soup(row.size);
  for (const PathologicalScene& scene : PathologicalScenes()) {
    if (scene.name == row.scene) return scene.make(row.size);
  }
  return absl::InvalidArgumentError(absl::StrCat("no scene '", std::string(row.scene), "' of another size"));
}

std::vector<Ray> MakeRays(std::string_view name, const std::shared_ptr<const TriangleMesh>& mesh, uint32_t count) {
  constexpr uint64_t kSeed = 500;
  for (const HardRays& family : HardRayFamilies()) {
    if (family.name == name) return family.make(*mesh, count, kSeed);
  }
  const Bounds bounds = MeshBounds(*mesh);
  if (name == "chords") return ChordRays(bounds, count, kSeed);
  const auto side = static_cast<uint32_t>(std::ceil(std::sqrt(static_cast<double>(count))));
  if (name == "camera") return CameraRays(bounds, side, side);
  // The others start or end where rays hit. Enough of them, though most may miss.
  const std::shared_ptr<Build> build = Build::Start(mesh, {});
  if (!build->WaitDone().ok()) return {};
  const Tree& tree = *build->snapshot()->tree;
  return name == "bounce" ? BounceRays(*mesh, tree, CameraRays(bounds, 4 * side, 4 * side), kSeed)
                          : RaysEndingAtHits(tree, ChordRays(bounds, 4 * count, kSeed));
}

}  // namespace

std::vector<std::string> StabilityFamilyNames() {
  std::vector<std::string> names;
  for (const Row& row : kRows) names.emplace_back(row.name);
  return names;
}

absl::StatusOr<StabilityFamily> MakeStabilityFamily(std::string_view name, uint32_t ray_count) {
  const auto row = std::ranges::find(kRows, name, &Row::name);
  if (row == std::end(kRows)) {
    return absl::InvalidArgumentError(
        absl::StrCat("no family '", std::string(name), "'; there are ", absl::StrJoin(StabilityFamilyNames(), ", ")));
  }
  absl::StatusOr<TriangleMesh> made = MakeMesh(*row);
  if (!made.ok()) return made.status();
  StabilityFamily family{std::string(name), std::make_shared<const TriangleMesh>(*std::move(made)), {}};
  family.rays = MakeRays(row->rays, family.mesh, ray_count);
  if (family.rays.size() < ray_count) {
    return absl::InternalError(absl::StrCat("only ", family.rays.size(), " rays could be made for ", family.name));
  }
  family.rays.resize(ray_count);
  return family;
}

}  // namespace deltaray
