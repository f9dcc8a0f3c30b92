// The canonical bytes of a mesh: what its id is the SHA-256 of, and what the store writes.

#ifndef SERVER_MESH_CANONICAL_H_
#define SERVER_MESH_CANONICAL_H_

#include <cstdint>
#include <functional>
#include <span>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/mesh/triangle_mesh.h"

namespace deltaray {

// Writes the canonical bytes of `mesh`, piece by piece and in order, to `sink`; stops and returns its first error. Two
// meshes have the same bytes if and only if they have the same geometry, faces and groups.
absl::Status WriteCanonical(const TriangleMesh& mesh, const std::function<absl::Status(absl::string_view)>& sink);

// Reads what WriteCanonical wrote and checks every invariant of TriangleMesh; DATA_LOSS where one does not hold.
absl::StatusOr<TriangleMesh> ReadCanonical(std::span<const char> bytes);

// SHA-256 of the canonical bytes: 64 lower-case hexadecimal digits.
std::string MeshId(const TriangleMesh& mesh);

}  // namespace deltaray

#endif  // SERVER_MESH_CANONICAL_H_
