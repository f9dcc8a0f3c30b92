// Takes vertices and faces from a reader, and holds them to the limits.

#ifndef SERVER_MESH_FACE_COLLECTOR_H_
#define SERVER_MESH_FACE_COLLECTOR_H_

#include <cstdint>
#include <span>
#include <string>

#include "absl/container/flat_hash_map.h"
#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "server/mesh/location.h"
#include "server/mesh/polygon_mesh.h"
#include "server/mesh/read_mesh.h"
#include "server/mesh/warnings.h"

namespace deltaray {

// What every reader pushes its finds into. `where` is the place in the file that an error names. Not thread-safe.
class FaceCollector {
 public:
  // `options` must outlive it. `first_index` is the number that the file's format gives to its first vertex; only texts
  // of errors need it.
  FaceCollector(const ReadMeshOptions& options, uint32_t first_index);

  // INVALID_ARGUMENT where a coordinate is NaN or outside of float32's range; RESOURCE_EXHAUSTED over max_vertices.
  absl::Status AddVertex(const Vec3d& position, Location where);

  // Adds a face of the current group. Corners are vertex indices from 0, of vertices that may be added later.
  // INVALID_ARGUMENT for fewer than three corners; RESOURCE_EXHAUSTED over max_face_corners or max_triangles.
  absl::Status AddFace(std::span<const uint32_t> corners, Location where);

  // Puts the faces from here on into the group `name`; in none where it is empty. A group without a face is not kept.
  absl::Status SetGroup(absl::string_view name, Location where);

  void Warn(std::string sentence) { warnings_.Add(std::move(sentence)); }

  // CANCELLED once the caller has asked for it. Quick: asks only now and then.
  absl::Status Poll();

  // Makes room for what a file announces; only as much as it can hold.
  void Reserve(uint64_t vertices, uint64_t faces);

  uint64_t vertex_count() const { return mesh_.vertices.size(); }
  const Vec3d& vertex(uint32_t index) const { return mesh_.vertices[index]; }
  uint64_t face_count() const { return mesh_.face_count; }
  const MeshLimits& limits() const { return options_.limits; }

  // The mesh, triangulated and described; the result's `format` is left to the caller. INVALID_ARGUMENT where a face
  // names a vertex that was never added. To be called once, last.
  absl::StatusOr<ReadMeshResult> Finish();

 private:
  // Asks for the memory that what is there and `corners` more may take, at once and until the mesh is finished.
  absl::Status TakeMemory(uint64_t corners);
  // Sets current_group_ to the group of group_name_, which is added to the list where it is new.
  absl::Status EnterGroup(Location where);

  const ReadMeshOptions& options_;
  const uint32_t first_index_;
  PolygonMesh mesh_;
  Warnings warnings_;
  uint64_t triangle_count_ = 0;
  uint64_t polls_ = 0;
  uint64_t memory_taken_ = 0;  // bytes that options_.take_memory was asked for

  std::string group_name_;
  bool group_entered_ = true;  // whether current_group_ is the group of group_name_
  uint32_t current_group_ = kNoGroup;
  uint64_t group_bytes_ = 0;  // of the names of all groups
  absl::flat_hash_map<std::string, uint32_t> group_index_;

  // How many vertices the faces need, where that was more than there were; and the first face that needs as many.
  uint64_t vertices_needed_ = 0;
  Location vertices_needed_where_;
};

}  // namespace deltaray

#endif  // SERVER_MESH_FACE_COLLECTOR_H_
