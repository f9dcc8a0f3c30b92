// A validated triangle mesh.

#ifndef SERVER_MESH_TRIANGLE_MESH_H_
#define SERVER_MESH_TRIANGLE_MESH_H_

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "server/geometry/bounds.h"
#include "server/geometry/triangles.h"
#include "server/geometry/vec3.h"

namespace deltaray {

// The group id of a triangle that is in no group.
inline constexpr uint32_t kNoGroup = 0xFFFFFFFF;

// The most vertices, triangles or faces of a mesh.
inline constexpr uint64_t kMaxMeshCount = (uint64_t{1} << 31) - 1;

// Triangles, and where in the file they came from. Immutable once it is shared.
//
// Invariants: every index is below positions.size(); every coordinate is finite, also after `origin` is added;
// triangles, faces and vertices are each fewer than 2^31; group names are valid UTF-8 without control characters.
struct TriangleMesh {
  // Vertices relative to `origin`, rounded to float32.
  std::vector<Vec3f> positions;
  // Corners of the triangles, in the order of the file's faces. The index here is the primitive id.
  std::vector<std::array<uint32_t, 3>> indices;
  // The point of the file's coordinates that positions are relative to. Zero where the mesh is not far from zero for
  // its size (see origin.h); else near the centre of the mesh.
  Vec3d origin;
  // Per triangle: the face (polygon) of the file that it came from. Empty: triangle i came from face i.
  std::vector<uint32_t> face_ids;
  // Per triangle: index into groups, or kNoGroup. Empty: no triangle is in a group.
  std::vector<uint32_t> group_ids;
  std::vector<std::string> groups;
  // Number of faces in the file.
  uint64_t face_count = 0;

  TrianglesView triangles() const { return {positions, indices}; }
  uint32_t FaceId(uint32_t primitive) const { return face_ids.empty() ? primitive : face_ids[primitive]; }
  uint32_t GroupId(uint32_t primitive) const { return group_ids.empty() ? kNoGroup : group_ids[primitive]; }
  // Bytes of memory that the arrays take.
  uint64_t Bytes() const;
};

// What was found out about a mesh while it was read. Not part of its identity.
struct MeshReport {
  uint64_t degenerate_triangles = 0;  // exactly zero area, as stored
  double max_rounding = 0;            // largest |stored - given| of any coordinate, in the file's unit
  Bounds bounds;                      // of the stored positions, relative to the mesh's origin
  std::vector<std::string> warnings;  // sentences, at most 100
};

}  // namespace deltaray

#endif  // SERVER_MESH_TRIANGLE_MESH_H_
