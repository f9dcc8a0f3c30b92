// A data directory, and what is known of it.

#ifndef SERVER_STORE_FOLLOWED_DIRECTORY_H_
#define SERVER_STORE_FOLLOWED_DIRECTORY_H_

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/build/mutex.h"
#include "server/store/catalog.h"
#include "server/store/data_directory.h"
#include "server/store/mesh_entry.h"

namespace deltaray {

using EntryPointer = std::shared_ptr<MeshEntry>;

// Entries whose meshes turned out to be deleted. Their waiters are told at the end: make it before a lock is taken.
class DroppedEntries {
 public:
  ~DroppedEntries();
  void Add(EntryPointer entry) {
    if (entry) entries_.push_back(std::move(entry));
  }

 private:
  std::vector<EntryPointer> entries_;
};

// Keeps the catalog up to date with the directory, which any number of servers change, and finds in it what has come
// since. Thread-safe.
class FollowedDirectory {
 public:
  // `make_entry` makes the entry of a mesh that was found. Follows others' changes from here on, each within some
  // `interval`. A look at the directory that comes later than it should by `hang` is held up by a disk that hangs.
  FollowedDirectory(DataDirectory directory, DataDirectory::Changes contents, std::chrono::milliseconds interval,
                    std::function<EntryPointer(MeshInfo)> make_entry,
                    std::chrono::milliseconds hang = std::chrono::seconds(30));
  ~FollowedDirectory();

  const Catalog& catalog() const { return catalog_; }
  Catalog& catalog() { return catalog_; }
  // Its Look is not to be called.
  const DataDirectory& files() const { return directory_; }

  // Whether the directory could be written to when that was last looked at, a second ago or so. Not where the disk
  // hangs.
  bool is_writable() const {
    return is_writable_ && std::chrono::steady_clock::now().time_since_epoch() < hangs_from_.load();
  }

  // The mesh of an id or a name; looked for on disk where it is not known yet.
  absl::StatusOr<EntryPointer> Find(absl::string_view mesh);
  // Whether a mesh is on disk now, whatever was known of it.
  bool IsThere(const std::string& id);
  // A mesh whose file is there and not known to be damaged; else null.
  EntryPointer FindWhole(const std::string& id);

  // Held while the directory is read or changed and the catalog with it, so that both change in the same order.
  Mutex& mutex() ABSL_LOCK_RETURNED(mutex_) { return mutex_; }

  // Each brings what is known up to date with the disk: of one mesh, of the mesh of an id or a name, of one name, of
  // all. They return what is there; NOT_FOUND where there is nothing.
  absl::StatusOr<EntryPointer> ReadMesh(const std::string& id, DroppedEntries* dropped)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::StatusOr<EntryPointer> ReadTarget(absl::string_view mesh, DroppedEntries* dropped)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::StatusOr<std::string> ReadName(const std::string& name) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::Status ReadAll(DroppedEntries* dropped) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // ReadMesh; null where the file is not there, or known to be damaged.
  EntryPointer ReadWhole(const std::string& id, DroppedEntries* dropped) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  // Catalog::Put and MoveName of what this server has changed on disk.
  void NotePut(EntryPointer entry) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  std::string NoteName(const std::string& name, const std::string& id) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

 private:
  void Take(DataDirectory::Changes changes, DroppedEntries* dropped) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  EntryPointer TakeMesh(MeshInfo info) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Notices what other servers change, until the end.
  void Follow();
  // Looks whether the directory can be written to, and logs where that has changed.
  void LookWhetherWritable();

  const std::chrono::milliseconds interval_, hang_;
  const std::function<EntryPointer(MeshInfo)> make_entry_;
  Catalog catalog_;
  Mutex mutex_;
  std::atomic<bool> is_writable_{true};
  std::atomic<std::chrono::steady_clock::duration> hangs_from_;  // unless a look has ended before
  DataDirectory directory_;                                      // what of it is not thread-safe is guarded by mutex_

  Mutex stop_mutex_;
  Condition stop_changed_;
  bool stopped_ ABSL_GUARDED_BY(stop_mutex_) = false;
  std::thread follower_;
};

}  // namespace deltaray

#endif  // SERVER_STORE_FOLLOWED_DIRECTORY_H_
