// What a data directory's meshes are served from.

#ifndef SERVER_STORE_STORE_H_
#define SERVER_STORE_STORE_H_

#include <cstddef>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/store/build_queue.h"
#include "server/store/change_lock.h"
#include "server/store/data_directory.h"
#include "server/store/disk_budget.h"
#include "server/store/followed_directory.h"
#include "server/store/mesh_entry.h"
#include "server/store/mesh_store.h"
#include "server/store/new_mesh.h"
#include "server/store/tree_budget.h"

namespace deltaray {

// The MeshStore of a data directory: mesh_store.cc answers, store_uploads.cc and store_changes.cc change the directory.
class Store final : public MeshStore {
 public:
  Store(Options options, DataDirectory directory, DataDirectory::Changes contents);
  ~Store() override;

  absl::StatusOr<std::unique_ptr<Upload>> StartUpload() override;
  absl::StatusOr<MeshInfo> Get(absl::string_view mesh) const override;
  absl::StatusOr<std::string> Resolve(absl::string_view mesh) const override;
  absl::StatusOr<std::string> ResolveKnown(absl::string_view mesh) const override;
  std::vector<MeshInfo> List(absl::string_view after_id, size_t limit) const override;
  absl::StatusOr<std::string> Name(absl::string_view name, absl::string_view mesh) override;
  absl::StatusOr<std::string> Delete(absl::string_view mesh) override;
  absl::StatusOr<MeshInfo> Rebuild(absl::string_view mesh, const Config& config) override;
  void WithTree(absl::string_view mesh, bool final, std::function<void(absl::StatusOr<Answer>)> callback,
                std::function<bool()> cancelled) override;
  void ForgetCancelled() override { directory_.catalog().ForgetCancelled(); }
  void StopWaiting(const absl::Status& status) override { directory_.catalog().StopWaiting(status); }
  void NoteAnswer(const Answer& answer) override;
  absl::StatusOr<BuildReport> Watch(absl::string_view mesh, bool start) override;
  absl::StatusOr<StoredStatistics> Statistics(absl::string_view mesh) const override;
  StoreUsage Usage() const override;

  const Options& options() const { return options_; }
  std::shared_ptr<TreeBudget::Reservation> NewReservation() { return tree_budget_->Empty(); }
  // Stores an upload's mesh, or finds that it is there already.
  absl::StatusOr<Upload::Committed> Put(const NewMesh& upload);

 private:
  // The mesh first, and the name last: whenever the server dies, no config or name is without its mesh. After an error
  // what is in memory is what is on disk, and each name points at what it pointed at before or at the mesh.
  absl::Status MoveFiles(const NewMesh& upload, PreparedFiles& files, DroppedEntries* dropped)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(directory_.mutex());
  absl::Status RemoveMeshFiles(const std::string& id) ABSL_EXCLUSIVE_LOCKS_REQUIRED(directory_.mutex());
  // Tells, by `not_found`, that there is nothing to remove: durably, since the removal before may have failed midway.
  absl::Status NothingToRemove(const absl::Status& not_found) const;

  void WithTree(const absl::StatusOr<EntryPointer>& entry, const std::string& mesh, bool final, int tries,
                std::function<void(absl::StatusOr<Answer>)> callback, std::function<bool()> cancelled);

  // Writes the config and starts the build. Returns the id.
  absl::StatusOr<std::string> ChangeConfig(absl::string_view mesh, const Config& config);
  // Whether the mesh's file is there and whole, as it is read now. Errors where that cannot be told.
  absl::StatusOr<bool> IsOnDisk(const NewMesh& upload);
  // Whether an upload may add what it adds.
  absl::Status CheckLimits(const NewMesh& upload, bool is_new) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(directory_.mutex());
  absl::Status CheckNameLimits(const std::string& name, const std::string& id) const;
  EntryPointer MakeEntry(MeshInfo info) const;

  const Options options_;
  mutable BuildQueue queue_;  // outlives the entries
  const std::shared_ptr<TreeBudget> tree_budget_;
  DiskBudget disk_budget_;
  mutable FollowedDirectory directory_;
  ChangeLock change_lock_;  // before directory_.mutex()
};

}  // namespace deltaray

#endif  // SERVER_STORE_STORE_H_
