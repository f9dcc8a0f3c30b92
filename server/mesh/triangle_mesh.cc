#include "server/mesh/triangle_mesh.h"

namespace deltaray {

uint64_t TriangleMesh::Bytes() const {
  uint64_t bytes = positions.capacity() * sizeof(positions[0]) + indices.capacity() * sizeof(indices[0]) +
                   face_ids.capacity() * sizeof(face_ids[0]) + group_ids.capacity() * sizeof(group_ids[0]) +
                   groups.capacity() * sizeof(groups[0]);
  for (const std::string& name : groups) bytes += name.capacity();
  return bytes;
}

}  // namespace deltaray
