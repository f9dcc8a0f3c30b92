// Where things lie in the data directory.
//
//   meshes/<mesh id>.mesh            mesh_file.h
//   configs/<mesh id>.config         record_file.h; only where a client gave one
//   names/<SHA-256 of name>.name     record_file.h
//   tmp/                             files on their way to their place; durable_file.h
//
// No path is made of a string that a client gave.

#ifndef SERVER_STORE_DATA_DIRECTORY_H_
#define SERVER_STORE_DATA_DIRECTORY_H_

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/store/durable_file.h"
#include "server/store/mesh_store.h"
#include "server/store/record_file.h"

namespace deltaray {

// Thread-safe.
class DataDirectory {
 public:
  struct Contents {
    std::vector<MeshInfo> meshes;   // without names and state
    std::vector<NameRecord> names;  // each of one of the meshes
  };

  // Makes the directory where missing, removes what dead servers left half done, and reads what is there into
  // `contents`: of the meshes only what stands before the geometry. What is not whole is logged and left out.
  static absl::StatusOr<DataDirectory> Open(const std::string& path, Contents* contents);

  // REQUIRES: IsMeshId(id).
  std::string MeshPath(absl::string_view id) const;
  std::string ConfigPath(absl::string_view id) const;
  std::string NamePath(absl::string_view name) const;
  std::string TemporariesPath() const { return path_ + "/tmp"; }

  // A temporary with this content, synced, ready to be moved to its place.
  absl::StatusOr<TemporaryFile> Prepare(absl::string_view content) const;

 private:
  explicit DataDirectory(std::string path) : path_(std::move(path)) {}

  absl::Status Read(Contents* contents) const;
  absl::Status ReadMeshes(Contents* contents, size_t* refused) const;
  absl::Status ReadNames(Contents* contents, size_t* refused) const;
  absl::Status RemoveStrayConfigs() const;
  Config ReadConfig(absl::string_view id, size_t* refused) const;
  // The files in a folder whose names end so, without that ending, in order. Others are logged and counted.
  absl::StatusOr<std::vector<std::string>> ListFiles(absl::string_view folder, absl::string_view ending,
                                                     size_t* refused) const;

  std::string path_;
};

}  // namespace deltaray

#endif  // SERVER_STORE_DATA_DIRECTORY_H_
