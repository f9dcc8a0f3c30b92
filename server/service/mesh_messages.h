// The messages of mesh.proto and mesh_service.proto, to and from the types of the layers below.

#ifndef SERVER_SERVICE_MESH_MESSAGES_H_
#define SERVER_SERVICE_MESH_MESSAGES_H_

#include "absl/status/statusor.h"
#include "deltaray/v1/mesh.pb.h"
#include "deltaray/v1/mesh_service.pb.h"
#include "server/store/mesh_store.h"

namespace deltaray {

// The preset's values for what is unset. INVALID_ARGUMENT, naming the field and its range.
absl::StatusOr<Config> ReadBuildOptions(const v1::BuildOptions& options);
// Every field set.
v1::BuildOptions ToMessage(const Config& config);

v1::Mesh ToMessage(const MeshInfo& info);
v1::BuildProgress ToMessage(const BuildReport& report);
v1::BuildStats ToMessage(const StoredStatistics& statistics);

// All that the header says of the commit, checked as far as it can be without the file. `max_upload_bytes` is the limit
// on UploadHeader.size_bytes.
absl::StatusOr<Upload::CommitOptions> ReadUploadHeader(const v1::UploadHeader& header, uint64_t max_upload_bytes);

}  // namespace deltaray

#endif  // SERVER_SERVICE_MESH_MESSAGES_H_
