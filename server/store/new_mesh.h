// From a finished upload to files that only need to be moved to their places.

#ifndef SERVER_STORE_NEW_MESH_H_
#define SERVER_STORE_NEW_MESH_H_

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/store/data_directory.h"
#include "server/store/disk_budget.h"
#include "server/store/durable_file.h"
#include "server/store/mesh_entry.h"
#include "server/store/mesh_file.h"
#include "server/store/mesh_store.h"
#include "server/store/tree_budget.h"
#include "server/store/upload_file.h"

namespace deltaray {

// A mesh that was uploaded, and what is to become of it.
struct NewMesh {
  LoadedMesh loaded;
  MeshDigest digest;
  MeshInfo info;     // with id, without config
  std::string name;  // empty: none
  std::optional<Config> config;
  std::function<bool()> cancelled;  // may be null

  bool IsCancelled() const { return cancelled && cancelled(); }
};

// Checks what arrived against what was announced, and reads it. Errors are those of ReadMesh, and INVALID_ARGUMENT for
// a malformed name or config or a wrong size or checksum. `memory` grows as the mesh is read.
absl::StatusOr<NewMesh> ReadNewMesh(UploadFile file, const Upload::CommitOptions& options, const MeshLimits& limits,
                                    std::shared_ptr<TreeBudget::Reservation> memory);

// Files of a new mesh under temporary names, written and synced, so that little can fail once the first one is moved.
struct PreparedFiles {
  explicit PreparedFiles(DiskBudget* budget) : charge(budget) {}

  DiskBudget::Charge charge;  // of the mesh
  std::optional<TemporaryFile> mesh, config, name;

  // Writes config and name, where the upload has them.
  absl::Status PrepareLabels(const NewMesh& upload, const DataDirectory& directory);
  absl::Status PrepareMesh(const NewMesh& upload, const DataDirectory& directory);
  void DropMesh() {
    mesh.reset();
    charge.GiveBack();
  }
};

}  // namespace deltaray

#endif  // SERVER_STORE_NEW_MESH_H_
