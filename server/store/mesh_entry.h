// A stored mesh in memory: what is known of it, its builds, and who waits for them.

#ifndef SERVER_STORE_MESH_ENTRY_H_
#define SERVER_STORE_MESH_ENTRY_H_

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/build/mutex.h"
#include "server/store/build_queue.h"
#include "server/store/build_run.h"
#include "server/store/mesh_store.h"
#include "server/store/tree_budget.h"

namespace deltaray {

// The geometry of a mesh with the memory that it takes.
struct LoadedMesh {
  std::shared_ptr<TreeBudget::Reservation> memory;  // given back after the mesh is gone
  std::shared_ptr<const TriangleMesh> mesh;
};

// Life: stored, without a run -> a run is queued (Start, or whatever needs a tree) -> it loads and builds -> it
// answers -> it is finished. Rebuild begins a new run; the old one's tree answers until the new one's can: rays that
// take any tree go over to the new provisional one, those that want a final one keep the old final one until the new
// one is final. Drop brings a mesh back to where it was: stored. Close ends it all. Nothing here blocks on a build or
// on the disk.
//
// Thread-safe. Callbacks are called without a lock held.
class MeshEntry : public std::enable_shared_from_this<MeshEntry> {
 public:
  // `info`: as read from the mesh's file at `path`, with its config, without groups. `queue` and `budget` outlive the
  // entry's builds.
  MeshEntry(MeshInfo info, std::string path, BuildQueue* queue, TreeBudget* budget);

  const std::string& id() const { return info_.id; }
  // Without names, which the store keeps, and without groups.
  MeshInfo Info() const;
  Config config() const;
  // Whether the mesh's file turned out to be lost or damaged when it was read.
  bool file_is_lost() const;
  // Reads the mesh's file and checks it. False: it is lost or damaged, and file_is_lost() from here on. Errors as of
  // CheckMeshFile, where it cannot be told.
  absl::StatusOr<bool> CheckFile(const std::function<bool()>& cancelled);

  uint64_t stored_bytes() const { return info_.stored_bytes; }

  // Starts a build where there is neither a build nor a tree, or where the last build failed, and the queue has room.
  // `loaded`, the same as in the file, saves reading that; may be empty.
  void Start(LoadedMesh loaded);
  // Cancels the build under way and starts another one. `loaded` as above. Where the queue is full, it is started by
  // whoever next asks for a tree or watches, once there is room; until then the old trees and build stay, and the mesh
  // is reported as one whose build waits.
  void Rebuild(const Config& config, LoadedMesh loaded);
  // Whether Rebuild with `config` has room in the queue, and the build in memory.
  absl::Status CheckRebuild(const Config& config) const;
  // Takes over the config that another server gave the mesh: where it differs, a tree or build of the old one is
  // replaced by a build of the new one, as by Rebuild.
  void SetConfig(const Config& config);
  // MeshStore::WithTree. A failed build is tried again by whoever comes a second later or more. Returns whether the
  // callback waits.
  bool WithTree(bool final, std::function<void(absl::StatusOr<MeshStore::Answer>)> callback,
                std::function<bool()> cancelled);
  // MeshStore::ForgetCancelled.
  void ForgetCancelled();
  bool IsWaitedFor() const;
  // MeshStore::StopWaiting.
  void StopWaiting(const absl::Status& status);
  // MeshStore::Watch.
  absl::StatusOr<BuildReport> Watch(bool start);
  // Adds this mesh to what all take in memory.
  void AddUsage(StoreUsage* usage) const;
  // MeshStore::Statistics.
  absl::StatusOr<StoredStatistics> Statistics() const;

  // When the tree was last asked for, or begun.
  std::chrono::steady_clock::time_point last_used() const { return std::chrono::steady_clock::time_point(last_used_); }
  // Bytes of memory that Drop lets go of.
  uint64_t DroppableBytes() const;
  // Lets go of the trees, but for that of a build under way, and of geometry that waits for its build, so that the next
  // query reads and builds the mesh. Their memory is retired. Returns what was dropped, for people; empty: nothing.
  std::string Drop();

  // Cancels the build and answers all who wait, now and later, with `status`.
  void Close(const absl::Status& status);

 private:
  struct Waiter {
    bool final;
    std::function<void(absl::StatusOr<MeshStore::Answer>)> callback;
    std::function<bool()> cancelled;  // may be empty
  };

  // REQUIRES: current_ is set. Of the run that is to come, where a rebuild is due.
  BuildReport CurrentReport() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Whether the current run has, or is to have, what somebody waits for.
  bool CurrentIsNeeded() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // What Drop lets go of, each once.
  std::vector<std::shared_ptr<TreeBudget::Reservation>> DroppableMemory() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool MayTryAgain() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Makes a new run, with config_, the current one. RESOURCE_EXHAUSTED, and nothing has changed, where the queue is
  // full.
  absl::Status StartRun(LoadedMesh loaded = {}) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Makes a new run the current one, or leaves that due. Returns what is to be cancelled after the lock; null: nothing.
  std::shared_ptr<BuildRun> ReplaceRun(LoadedMesh loaded = {}) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Starts what Rebuild and SetConfig could not, where there is room by now. Returns as ReplaceRun.
  std::shared_ptr<BuildRun> StartDueRebuild() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // On a thread of the queue, from begin to end of a build.
  void DoRun(const std::shared_ptr<BuildRun>& run);
  absl::StatusOr<std::shared_ptr<const TriangleMesh>> LoadMesh(const std::function<bool()>& cancelled);
  void BecomeProvisional(const std::shared_ptr<BuildRun>& run);
  void End(const std::shared_ptr<BuildRun>& run, const absl::Status& status);

  void Touch() { last_used_ = std::chrono::steady_clock::now().time_since_epoch(); }
  MeshStore::Answer AnswerFrom(const BuildRun& run) const;
  absl::Status BuildFailure(const absl::Status& status) const;

  const MeshInfo info_;  // without names, groups, state and failure; its config is the first one
  const std::string path_;
  BuildQueue* const queue_;
  TreeBudget* const budget_;
  std::atomic<std::chrono::steady_clock::duration> last_used_{};

  mutable Mutex mutex_;
  Config config_ ABSL_GUARDED_BY(mutex_);
  // Whether current_, which is set and does not wait in the queue, is to be replaced by a run with config_, for which
  // the queue had no room.
  bool rebuild_is_due_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Status closed_ ABSL_GUARDED_BY(mutex_);  // not OK once closed
  bool file_is_lost_ ABSL_GUARDED_BY(mutex_) = false;
  // The geometry on its way from an upload to the run that builds it.
  LoadedMesh uploaded_ ABSL_GUARDED_BY(mutex_);
  // The geometry, for as long as a tree or a build needs it.
  std::weak_ptr<const TriangleMesh> mesh_ ABSL_GUARDED_BY(mutex_);
  // The latest run; the latest one that has a tree; the latest one that was finished. Often the same.
  std::shared_ptr<BuildRun> current_ ABSL_GUARDED_BY(mutex_);
  std::shared_ptr<BuildRun> answering_ ABSL_GUARDED_BY(mutex_);
  std::shared_ptr<BuildRun> finished_ ABSL_GUARDED_BY(mutex_);
  std::chrono::steady_clock::time_point failed_at_ ABSL_GUARDED_BY(mutex_);  // when current_ failed, where it has
  std::vector<Waiter> waiters_ ABSL_GUARDED_BY(mutex_);
  absl::Status no_waiting_ ABSL_GUARDED_BY(mutex_);  // what those who would have to wait get, where not OK
};

}  // namespace deltaray

#endif  // SERVER_STORE_MESH_ENTRY_H_
