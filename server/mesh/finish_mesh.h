// The last steps of reading, the same for every format.

#ifndef SERVER_MESH_FINISH_MESH_H_
#define SERVER_MESH_FINISH_MESH_H_

#include <functional>

#include "absl/status/statusor.h"
#include "server/mesh/polygon_mesh.h"
#include "server/mesh/read_mesh.h"
#include "server/mesh/warnings.h"

namespace deltaray {

// Chooses the origin, rounds the positions, makes triangles of polygons, and describes the result. Every corner is
// below the number of vertices. CANCELLED once `cancelled`, which may be empty, returns true.
absl::StatusOr<ReadMeshResult> FinishMesh(PolygonMesh polygons, Warnings warnings,
                                          const std::function<bool()>& cancelled);

// The same for a mesh whose arrays stand already.
absl::StatusOr<ReadMeshResult> FinishMesh(TriangleMesh mesh, double max_rounding, Warnings warnings,
                                          const std::function<bool()>& cancelled);

}  // namespace deltaray

#endif  // SERVER_MESH_FINISH_MESH_H_
