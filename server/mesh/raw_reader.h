// Raw indexed arrays.

#ifndef SERVER_MESH_RAW_READER_H_
#define SERVER_MESH_RAW_READER_H_

#include <span>

#include "absl/status/statusor.h"
#include "server/mesh/read_mesh.h"

namespace deltaray {

// Reads arrays laid out as options.raw says. float32 positions keep their values.
absl::StatusOr<ReadMeshResult> ReadRaw(std::span<const char> bytes, const ReadMeshOptions& options);

}  // namespace deltaray

#endif  // SERVER_MESH_RAW_READER_H_
