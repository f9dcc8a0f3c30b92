// Where things lie in the data directory.
//
//   meshes/<mesh id>.mesh            mesh_file.h
//   configs/<mesh id>.config         record_file.h; only where a client gave one
//   names/<SHA-256 of name>.name     record_file.h
//   tmp/                             files on their way to their place; durable_file.h
//   lock                             held by the server that changes anything of the above
//
// No path is made of a string that a client gave.

#ifndef SERVER_STORE_DATA_DIRECTORY_H_
#define SERVER_STORE_DATA_DIRECTORY_H_

#include <chrono>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/store/durable_file.h"
#include "server/store/folder_watch.h"
#include "server/store/mesh_store.h"
#include "server/store/record_file.h"

namespace deltaray {

// Thread-safe, but for Look.
class DataDirectory {
 public:
  // What a look at the directory found, other than at the look before. A file that is not whole counts as gone.
  struct Changes {
    std::vector<MeshInfo> meshes;  // there, without names and state; may be known
    std::vector<std::string> gone_meshes;
    std::vector<std::pair<std::string, Config>> configs;  // by mesh id; the default one where it is gone
    std::vector<NameRecord> names;                        // there; their meshes may not be
    std::vector<std::string> gone_names;
  };

  // Makes the directory where missing, removes what dead servers left half done, and reads what is there into
  // `contents`: of the meshes only what stands before the geometry. What is not whole is logged and left out.
  // `lock_timeout`: as of Lock.
  static absl::StatusOr<DataDirectory> Open(const std::string& path, std::chrono::milliseconds lock_timeout,
                                            Changes* contents);

  // What any server has changed since the last call. After an error the next call tells what is missing in `changes`.
  // Not thread-safe.
  absl::Status Look(Changes* changes);

  // Tells at the next look of a mesh or a name that became known without one, also where it is gone by then. Not
  // thread-safe.
  void TellOfMesh(const std::string& id);
  void TellOfName(const std::string& name);

  // Whether all folders are there and may be written to, and the lock be taken, as CheckWritable and CheckLockable
  // tell.
  absl::Status CheckWritable() const;

  // What changes the directory holds this, so that it may look before it acts. UNAVAILABLE where another server has it
  // for longer than `timeout`, FAILED_PRECONDITION where a folder is gone: what is in it is not known.
  absl::StatusOr<FileDescriptor> Lock(std::chrono::milliseconds timeout) const;

  // What stands before the geometry, but for the groups, and the config. NOT_FOUND, DATA_LOSS and so on as
  // ReadMeshFileInfo; FAILED_PRECONDITION where the directory is gone.
  absl::StatusOr<MeshInfo> ReadMesh(const std::string& id) const;
  // Errors as above.
  absl::StatusOr<std::vector<std::string>> ReadGroups(const std::string& id) const;
  // NOT_FOUND where the mesh has none; FAILED_PRECONDITION as above.
  absl::StatusOr<Config> ReadConfig(absl::string_view id) const;
  // Whether a mesh's file is there, whole or not, as far as can be told: where the folder is gone, it may be.
  bool HasMesh(absl::string_view id) const;
  // The id that a name points at, of a mesh that may not be there. Errors as above.
  absl::StatusOr<std::string> ReadName(absl::string_view name) const;

  // REQUIRES: IsMeshId(id).
  std::string MeshPath(absl::string_view id) const;
  std::string ConfigPath(absl::string_view id) const;
  std::string NamePath(absl::string_view name) const;
  std::string NamesPath() const { return path_ + "/names"; }
  std::string TemporariesPath() const { return path_ + "/tmp"; }

  // Makes durable what was moved into the folders, and removed from there.
  absl::Status Sync() const;

  // A temporary with this content, synced, ready to be moved to its place.
  absl::StatusOr<TemporaryFile> Prepare(absl::string_view content) const;

 private:
  explicit DataDirectory(const std::string& path);

  absl::Status LookAtMeshes(Changes* changes);
  absl::Status LookAtNames(Changes* changes);
  // Whether it cannot be told for now, by what ReadConfig gave, what config a mesh has. (One without a config, or whose
  // config is refused, has the default one.)
  bool IsConfigUnknown(const absl::Status& read) const;
  // Removes names and configs without a mesh, as they stand where somebody took the mesh's file away.
  void RemoveStray(std::chrono::milliseconds lock_timeout, Changes* contents) const;

  std::string LockPath() const { return path_ + "/lock"; }
  std::string NamePathOfDigest(absl::string_view digest) const;
  absl::StatusOr<NameRecord> ReadNameFile(const std::string& digest) const;
  // Logs why a file is left out, once. True where it should be looked at again, since the error may pass.
  bool Refuse(const std::string& path, const absl::Status& status);

  std::string path_;
  FolderWatch meshes_, configs_, names_;
  absl::flat_hash_map<std::string, std::string> names_by_digest_;
  absl::flat_hash_set<std::string> refused_;  // paths
};

}  // namespace deltaray

#endif  // SERVER_STORE_DATA_DIRECTORY_H_
