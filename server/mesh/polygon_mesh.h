// The faces of a file as they stand there, before polygons become triangles.

#ifndef SERVER_MESH_POLYGON_MESH_H_
#define SERVER_MESH_POLYGON_MESH_H_

#include <cstdint>
#include <string>
#include <vector>

#include "server/geometry/vec3.h"
#include "server/mesh/triangle_mesh.h"

namespace deltaray {

struct PolygonMesh {
  // In the file's coordinates; each one fits the range of float32.
  std::vector<Vec3d> vertices;
  // Vertex indices of all faces, one face after the other.
  std::vector<uint32_t> corners;
  // Corners per face, each at least 3. Empty: every face has three.
  std::vector<uint32_t> face_sizes;
  // Per face: index into groups, or kNoGroup. Empty: no face is in a group.
  std::vector<uint32_t> face_groups;
  std::vector<std::string> groups;
  uint64_t face_count = 0;
};

}  // namespace deltaray

#endif  // SERVER_MESH_POLYGON_MESH_H_
