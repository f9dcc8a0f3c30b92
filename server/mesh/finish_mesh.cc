#include "server/mesh/finish_mesh.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "server/geometry/triangle_test.h"
#include "server/mesh/origin.h"
#include "server/mesh/triangulate.h"

namespace deltaray {
namespace {

absl::Status Cancelled() { return absl::CancelledError("reading the mesh was cancelled"); }

// Asks `cancelled` once in so many steps.
bool ShallStop(const std::function<bool()>& cancelled, uint64_t step) {
  return step % 4096 == 0 && cancelled && cancelled();
}

// Appends the triangles of all faces to `mesh`, whose positions stand already.
absl::Status MakeTriangles(const PolygonMesh& polygons, Warnings* warnings, const std::function<bool()>& cancelled,
                           TriangleMesh* mesh) {
  const uint64_t triangle_count = polygons.corners.size() - 2 * polygons.face_count;
  mesh->indices.reserve(triangle_count);
  if (!polygons.face_sizes.empty()) mesh->face_ids.reserve(triangle_count);
  if (!polygons.face_groups.empty()) mesh->group_ids.reserve(triangle_count);
  Triangulator triangulator(mesh->positions);
  size_t begin = 0;
  uint64_t work = 0;
  for (uint64_t face = 0; face < polygons.face_count; ++face) {
    const uint32_t size = polygons.face_sizes.empty() ? 3 : polygons.face_sizes[face];
    if (ShallStop(cancelled, size > 64 ? 0 : work++)) return Cancelled();
    const std::span<const uint32_t> corners(polygons.corners.data() + begin, size);
    if (!triangulator.Append(corners, &mesh->indices)) {
      warnings->Add(absl::StrCat("Face ", face, " of ", size,
                                 " corners is not a simple polygon; its triangles are a fan and may overlap."));
    }
    if (!polygons.face_sizes.empty()) mesh->face_ids.resize(mesh->indices.size(), face);
    if (!polygons.face_groups.empty()) mesh->group_ids.resize(mesh->indices.size(), polygons.face_groups[face]);
    begin += size;
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<ReadMeshResult> FinishMesh(PolygonMesh polygons, Warnings warnings,
                                          const std::function<bool()>& cancelled) {
  TriangleMesh mesh;
  mesh.origin = ChooseOrigin(polygons);
  StoredPositions stored = StorePositions(polygons.vertices, mesh.origin);
  polygons.vertices = {};  // The largest array is not needed any more.
  mesh.positions = std::move(stored.positions);
  mesh.groups = std::move(polygons.groups);
  mesh.face_count = polygons.face_count;
  if (absl::Status status = MakeTriangles(polygons, &warnings, cancelled, &mesh); !status.ok()) return status;
  return FinishMesh(std::move(mesh), stored.max_rounding, std::move(warnings), cancelled);
}

absl::StatusOr<ReadMeshResult> FinishMesh(TriangleMesh mesh, double max_rounding, Warnings warnings,
                                          const std::function<bool()>& cancelled) {
  ReadMeshResult result;
  result.report.max_rounding = max_rounding;
  for (const Vec3f& position : mesh.positions) result.report.bounds.Extend(position);
  const TrianglesView triangles = mesh.triangles();
  for (size_t i = 0; i < triangles.size(); ++i) {
    if (ShallStop(cancelled, i)) return Cancelled();
    if (IsDegenerate(triangles[i])) ++result.report.degenerate_triangles;
  }
  if (triangles.size() == 0) {
    warnings.Add("The mesh has no triangle.");
  } else if (result.report.degenerate_triangles > 0) {
    warnings.Add(absl::StrCat(result.report.degenerate_triangles, " of ", triangles.size(),
                              " triangles have no area as stored; no ray hits them."));
  }
  result.report.warnings = warnings.Take();
  result.mesh = std::move(mesh);
  return result;
}

}  // namespace deltaray
