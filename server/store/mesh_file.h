// The file of a stored mesh. Its layout stands, to the byte, in README.md.

#ifndef SERVER_STORE_MESH_FILE_H_
#define SERVER_STORE_MESH_FILE_H_

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/mesh/triangle_mesh.h"
#include "server/store/durable_file.h"
#include "server/store/mesh_store.h"

namespace deltaray {

// What the canonical bytes of a mesh come to.
struct MeshDigest {
  std::string sha256;  // 32 bytes; in hexadecimal the mesh's id
  uint64_t bytes = 0;
};
absl::StatusOr<MeshDigest> DigestMesh(const TriangleMesh& mesh);

// The size of the file that WriteMeshFile writes.
uint64_t MeshFileBytes(const MeshDigest& digest, const MeshInfo& info);
// Writes the file of `mesh`. Of `info` it keeps what neither the geometry's bytes nor other files tell: counts, origin,
// groups, report and time of creation.
absl::Status WriteMeshFile(const TriangleMesh& mesh, const MeshDigest& digest, const MeshInfo& info,
                           TemporaryFile* file);

// Reads and checks what stands before the geometry, so that a folder of thousands of meshes is quick to open. Fills
// `stored_bytes`, but not names, state, config and groups, which may be large. DATA_LOSS, naming the file, where it is
// malformed, truncated or has trailing bytes; FAILED_PRECONDITION where a newer deltaray wrote it; else as
// FileError.
absl::StatusOr<MeshInfo> ReadMeshFileInfo(const std::string& path);
// The groups of the mesh of this id. Errors as above.
absl::StatusOr<std::vector<std::string>> ReadMeshFileGroups(const std::string& path, const std::string& id);

// Reads and checks the whole file, whose mesh must have this id. Errors as above; CANCELLED soon after `cancelled`
// returns true.
absl::StatusOr<TriangleMesh> ReadMeshFile(const std::string& path, const std::string& id,
                                          const std::function<bool()>& cancelled);

// Reads the whole file and checks that it holds the bytes of the mesh of this id, without taking memory for it. OK, or
// errors as above.
absl::Status CheckMeshFile(const std::string& path, const std::string& id, const std::function<bool()>& cancelled);

}  // namespace deltaray

#endif  // SERVER_STORE_MESH_FILE_H_
