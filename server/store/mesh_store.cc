#include "server/store/mesh_store.h"

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/build/mutex.h"
#include "server/store/build_queue.h"
#include "server/store/build_run.h"
#include "server/store/change_lock.h"
#include "server/store/data_directory.h"
#include "server/store/disk_budget.h"
#include "server/store/durable_file.h"
#include "server/store/followed_directory.h"
#include "server/store/mesh_entry.h"
#include "server/store/mesh_name.h"
#include "server/store/new_mesh.h"
#include "server/store/record_file.h"
#include "server/store/tree_budget.h"
#include "server/store/upload_file.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

// How often a mesh is asked for again that was deleted and is there again.
constexpr int kTriesOfDeletedMesh = 3;

absl::StatusOr<std::string> IdOf(const absl::StatusOr<EntryPointer>& entry) {
  if (!entry.ok()) return entry.status();
  return (*entry)->id();
}

class Store final : public MeshStore {
 public:
  Store(Options options, DataDirectory directory, DataDirectory::Changes contents);
  ~Store() override;

  absl::StatusOr<std::unique_ptr<Upload>> StartUpload() override;
  absl::StatusOr<MeshInfo> Get(absl::string_view mesh) const override;
  absl::StatusOr<std::string> Resolve(absl::string_view mesh) const override { return IdOf(directory_.Find(mesh)); }
  absl::StatusOr<std::string> ResolveKnown(absl::string_view mesh) const override {
    return IdOf(directory_.catalog().Find(mesh));
  }
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

class StoreUpload final : public Upload {
 public:
  StoreUpload(Store* store, UploadFile file) : store_(store), file_(std::move(file)) {}

  absl::Status Append(absl::string_view bytes) override { return file_.Append(bytes); }
  uint64_t size() const override { return file_.size(); }

  absl::StatusOr<Committed> Commit(CommitOptions options) override {
    // The upload's bytes are gone before the mesh is written, which may need their room.
    const absl::StatusOr<NewMesh> mesh =
        ReadNewMesh(std::move(file_), options, store_->options().mesh_limits, store_->NewReservation());
    if (!mesh.ok()) return mesh.status();
    return store_->Put(*mesh);
  }

 private:
  Store* const store_;
  UploadFile file_;
};

Store::Store(Options options, DataDirectory directory, DataDirectory::Changes contents)
    : options_(std::move(options)),
      queue_(options_.concurrent_builds, options_.max_queued_builds,
             {.config = {}, .threads = options_.build_threads, .on_delta_leaf = options_.on_delta_leaf},
             options_.on_build_end),
      tree_budget_(std::make_shared<TreeBudget>(
          options_.tree_bytes, [this](uint64_t bytes) { return directory_.catalog().MakeRoom(bytes); })),
      disk_budget_(options_.max_stored_bytes, [this] { return directory_.catalog().totals().stored_bytes; }),
      directory_(std::move(directory), std::move(contents), options_.follow_interval,
                 [this](MeshInfo info) { return MakeEntry(std::move(info)); }),
      change_lock_(&directory_.files(), options_.change_timeout) {}

Store::~Store() {
  for (const EntryPointer& entry : directory_.catalog().List("", SIZE_MAX)) {
    entry->Close(absl::UnavailableError("the server is shutting down"));
  }
  queue_.Stop();
}

absl::StatusOr<std::unique_ptr<Upload>> Store::StartUpload() {
  absl::StatusOr<UploadFile> file =
      UploadFile::Create(directory_.files().TemporariesPath(), options_.max_upload_bytes, &disk_budget_);
  if (!file.ok()) return file.status();
  return std::make_unique<StoreUpload>(this, *std::move(file));
}

absl::StatusOr<Upload::Committed> Store::Put(const NewMesh& upload) {
  const std::string& id = upload.info.id;
  // A mesh that cannot be built yet is kept, but not with options that a client chose and that can never do.
  if (upload.config) {
    if (absl::Status status = CheckBuildFits(upload.info, *upload.config, *tree_budget_); !status.ok()) return status;
  }
  PreparedFiles files(&disk_budget_);
  if (absl::Status status = files.PrepareLabels(upload, directory_.files()); !status.ok()) return status;
  for (;;) {
    // Write a mesh that is new, or whose file is damaged, without the lock: it may be large.
    if (!files.mesh) {
      const absl::StatusOr<bool> is_on_disk = IsOnDisk(upload);
      if (!is_on_disk.ok()) return is_on_disk.status();
      if (!*is_on_disk) {
        if (absl::Status status = files.PrepareMesh(upload, directory_.files()); !status.ok()) return status;
      }
    }
    if (upload.IsCancelled()) return absl::CancelledError("the upload was cancelled");

    DroppedEntries dropped;
    const absl::StatusOr<ChangeLock::Held> lock = change_lock_.Take();
    if (!lock.ok()) return lock.status();
    MutexLock disk_lock(directory_.mutex());
    EntryPointer entry = directory_.ReadWhole(id, &dropped);
    if (!entry && !files.mesh) continue;  // deleted since
    if (entry) files.DropMesh();          // stored since, or long ago
    const bool same_config = entry && (!upload.config || EncodeConfig(*upload.config) == EncodeConfig(entry->config()));
    if (same_config) files.config.reset();
    Upload::Committed committed;
    committed.created = !directory_.catalog().Find(id).ok();
    if (absl::Status status = CheckLimits(upload, committed.created); !status.ok()) return status;
    if (absl::Status status = MoveFiles(upload, files, &dropped); !status.ok()) return status;

    const bool is_new = !entry;  // to memory: the mesh of a lost file is so again
    if (is_new) {
      // Names of one that another server has deleted a moment ago.
      for (const std::string& name : directory_.catalog().NamesOf(id)) directory_.ReadName(name).IgnoreError();
      MeshInfo info = upload.info;
      info.groups = {};
      const absl::StatusOr<Config> kept = directory_.files().ReadConfig(id);
      info.config = upload.config ? *upload.config : kept.ok() ? *kept : Config();
      entry = MakeEntry(std::move(info));
      files.charge.GiveBack([&] { directory_.NotePut(entry); });
    }
    if (!upload.name.empty()) directory_.NoteName(upload.name, id);
    spdlog::info("{} mesh {}: {} triangles{}{}", committed.created ? "stored" : "found again", id,
                 upload.info.triangle_count, upload.name.empty() ? "" : ", named ", upload.name);
    // Where the queue is full, the mesh is stored all the same, and built when it is asked for.
    if (is_new || same_config) {
      entry->Start(upload.loaded);
    } else {
      entry->Rebuild(*upload.config, upload.loaded);
    }
    committed.info = directory_.catalog().Info(*entry);
    committed.info.groups = upload.info.groups;  // are part of what the id stands for
    return committed;
  }
}

absl::StatusOr<bool> Store::IsOnDisk(const NewMesh& upload) {
  const EntryPointer entry = directory_.FindWhole(upload.info.id);
  if (!entry) return false;
  return entry->CheckFile([&] { return upload.IsCancelled(); });
}

absl::Status Store::CheckLimits(const NewMesh& upload, bool is_new) const {
  if (is_new && directory_.catalog().totals().meshes >= options_.max_meshes) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the limit of ", options_.max_meshes, " meshes is met (--max-meshes)"));
  }
  if (upload.name.empty()) return absl::OkStatus();
  directory_.ReadName(upload.name).IgnoreError();
  return CheckNameLimits(upload.name, upload.info.id);
}

absl::Status Store::CheckNameLimits(const std::string& name, const std::string& id) const {
  const std::set<std::string> names = directory_.catalog().NamesOf(id);
  if (names.count(name) != 0) return absl::OkStatus();
  if (names.size() >= options_.max_names_per_mesh) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the limit of ", options_.max_names_per_mesh, " names of one mesh is met (--max-names-per-mesh)"));
  }
  if (directory_.catalog().totals().names >= options_.max_names && !directory_.catalog().HasName(name)) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the limit of ", options_.max_names, " names is met (--max-names)"));
  }
  return absl::OkStatus();
}

EntryPointer Store::MakeEntry(MeshInfo info) const {
  std::string path = directory_.files().MeshPath(info.id);
  return std::make_shared<MeshEntry>(std::move(info), std::move(path), &queue_, tree_budget_.get());
}

absl::Status Store::MoveFiles(const NewMesh& upload, PreparedFiles& files, DroppedEntries* dropped) {
  const std::string& id = upload.info.id;
  const DataDirectory& disk = directory_.files();
  const bool was_there = disk.HasMesh(id);
  // What is there already may not be synced: its server may have died, or failed, right after it moved the file.
  const auto move = [](std::optional<TemporaryFile>& file, const std::string& place) {
    return file ? file->MoveTo(place) : SyncFolderOf(place);
  };
  absl::Status status = move(files.mesh, disk.MeshPath(id));
  if (status.ok() && upload.config) status = move(files.config, disk.ConfigPath(id));
  if (!status.ok()) {
    if (!was_there) RemoveMeshFiles(id).IgnoreError();
  } else if (!upload.name.empty()) {
    // From here on a name may point at the mesh, which therefore stays.
    status = files.name->MoveTo(disk.NamePath(upload.name));
    if (!status.ok()) directory_.ReadName(upload.name).IgnoreError();
  }
  if (!status.ok()) directory_.ReadMesh(id, dropped).IgnoreError();
  return status;
}

absl::StatusOr<MeshInfo> Store::Get(absl::string_view mesh) const {
  for (int tries = kTriesOfDeletedMesh;; --tries) {
    const absl::StatusOr<EntryPointer> entry = directory_.Find(mesh);
    if (!entry.ok()) return entry.status();
    absl::StatusOr<std::vector<std::string>> groups = directory_.files().ReadGroups((*entry)->id());
    if (groups.ok()) {
      MeshInfo info = directory_.catalog().Info(**entry);
      info.groups = *std::move(groups);
      return info;
    }
    if (!absl::IsNotFound(groups.status()) || tries == 0) return groups.status();
    // Another server has deleted it; it may be there again.
    directory_.IsThere((*entry)->id());
  }
}

std::vector<MeshInfo> Store::List(absl::string_view after_id, size_t limit) const {
  std::vector<MeshInfo> infos;
  for (const EntryPointer& entry : directory_.catalog().List(after_id, limit))
    infos.push_back(directory_.catalog().Info(*entry));
  return infos;
}

absl::StatusOr<std::string> Store::Name(absl::string_view name, absl::string_view mesh) {
  if (absl::Status status = ValidateMeshName(name); !status.ok()) return status;
  const std::string label(name);
  const std::string path = directory_.files().NamePath(label);

  DroppedEntries dropped;
  const absl::StatusOr<ChangeLock::Held> lock = change_lock_.Take();
  if (!lock.ok()) return lock.status();
  MutexLock disk_lock(directory_.mutex());
  const absl::StatusOr<std::string> pointed = directory_.ReadName(label);
  std::string id;
  absl::Status changed;
  if (mesh.empty()) {
    if (absl::IsNotFound(pointed.status())) {
      return NothingToRemove(absl::NotFoundError(absl::StrCat("no mesh is named ", name)));
    }
    changed = RemoveFile(path);
  } else {
    const absl::StatusOr<EntryPointer> target = directory_.ReadTarget(mesh, &dropped);
    if (!target.ok()) return target.status();
    id = (*target)->id();
    if (absl::Status status = CheckNameLimits(label, id); !status.ok()) return status;
    absl::StatusOr<TemporaryFile> file = directory_.files().Prepare(EncodeName({label, id}));
    if (!file.ok()) return file.status();
    changed = file->MoveTo(path);
  }
  if (!changed.ok()) {
    directory_.ReadName(label).IgnoreError();
    return changed;
  }
  const std::string previous = directory_.NoteName(label, id);
  if (id.empty()) {
    spdlog::info("took the name {} away from mesh {}", label, previous);
  } else {
    spdlog::info("named mesh {} {}", id, label);
  }
  return previous;
}

absl::StatusOr<std::string> Store::Delete(absl::string_view mesh) {
  DroppedEntries dropped;
  const absl::StatusOr<ChangeLock::Held> lock = change_lock_.Take();
  if (!lock.ok()) return lock.status();
  MutexLock disk_lock(directory_.mutex());
  // Other servers may have given it names.
  if (absl::Status status = directory_.ReadAll(&dropped); !status.ok()) return status;
  std::string id(mesh);
  const absl::StatusOr<EntryPointer> entry = directory_.ReadTarget(mesh, &dropped);
  if (entry.ok()) {
    id = (*entry)->id();
  } else if (!IsMeshId(mesh) || !directory_.files().HasMesh(mesh)) {
    return absl::IsNotFound(entry.status()) ? NothingToRemove(entry.status()) : entry.status();
  }
  // Names first, then config, then mesh, for the same reason as in MoveFiles.
  const std::set<std::string> names = directory_.catalog().NamesOf(id);
  std::vector<std::string> paths;
  for (const std::string& name : names) paths.push_back(directory_.files().NamePath(name));
  absl::Status removed = RemoveFiles(directory_.files().NamesPath(), paths);
  if (removed.ok()) removed = RemoveMeshFiles(id);
  if (!removed.ok()) {
    for (const std::string& name : names) directory_.ReadName(name).IgnoreError();
    directory_.ReadMesh(id, &dropped).IgnoreError();
    return removed;
  }
  for (const std::string& name : names) directory_.catalog().MoveName(name, "");
  dropped.Add(directory_.catalog().Remove(id));
  spdlog::info("deleted mesh {}", id);
  return id;
}

absl::Status Store::RemoveMeshFiles(const std::string& id) {
  if (absl::Status status = RemoveFile(directory_.files().ConfigPath(id)); !status.ok()) return status;
  return RemoveFile(directory_.files().MeshPath(id));
}

absl::Status Store::NothingToRemove(const absl::Status& not_found) const {
  const absl::Status synced = directory_.files().Sync();
  return synced.ok() ? not_found : synced;
}

absl::StatusOr<MeshInfo> Store::Rebuild(absl::string_view mesh, const Config& config) {
  if (absl::Status status = Validate(config); !status.ok()) return status;
  const absl::StatusOr<std::string> id = ChangeConfig(mesh, config);
  if (!id.ok()) return id.status();
  return Get(*id);
}

absl::StatusOr<std::string> Store::ChangeConfig(absl::string_view mesh, const Config& config) {
  DroppedEntries dropped;
  const absl::StatusOr<ChangeLock::Held> lock = change_lock_.Take();
  if (!lock.ok()) return lock.status();
  MutexLock disk_lock(directory_.mutex());
  const absl::StatusOr<EntryPointer> entry = directory_.ReadTarget(mesh, &dropped);
  if (!entry.ok()) return entry.status();
  if (absl::Status status = (*entry)->CheckRebuild(config); !status.ok()) return status;
  absl::StatusOr<TemporaryFile> file = directory_.files().Prepare(EncodeConfig(config));
  if (!file.ok()) return file.status();
  if (absl::Status status = file->MoveTo(directory_.files().ConfigPath((*entry)->id())); !status.ok()) {
    directory_.ReadMesh((*entry)->id(), &dropped).IgnoreError();
    return status;
  }
  (*entry)->Rebuild(config, {});
  return (*entry)->id();
}

void Store::WithTree(absl::string_view mesh, bool final, std::function<void(absl::StatusOr<Answer>)> callback,
                     std::function<bool()> cancelled) {
  WithTree(directory_.catalog().Find(mesh), std::string(mesh), final, kTriesOfDeletedMesh, std::move(callback),
           std::move(cancelled));
}

void Store::WithTree(const absl::StatusOr<EntryPointer>& entry, const std::string& mesh, bool final, int tries,
                     std::function<void(absl::StatusOr<Answer>)> callback, std::function<bool()> cancelled) {
  if (!entry.ok()) return callback(entry.status());
  // The caller must not wait for the disk; a thread of a build, which calls back later, may.
  const auto returned = std::make_shared<std::atomic<bool>>(tries < kTriesOfDeletedMesh);
  auto on_tree = [this, mesh, id = (*entry)->id(), final, tries, callback = std::move(callback), cancelled,
                  returned](absl::StatusOr<Answer> answer) {
    // Another server had deleted the mesh, and it may have been uploaded again before it was asked for.
    if (!absl::IsNotFound(answer.status()) || tries == 0 || !*returned || !directory_.IsThere(id)) {
      return callback(std::move(answer));
    }
    WithTree(directory_.Find(mesh), mesh, final, tries - 1, callback, cancelled);
  };
  if ((*entry)->WithTree(final, std::move(on_tree), std::move(cancelled))) directory_.catalog().NoteWaitedFor(*entry);
  *returned = true;
}

void Store::NoteAnswer(const Answer& answer) {
  if (answer.first_answer) answer.first_answer->Note();
}

absl::StatusOr<BuildReport> Store::Watch(absl::string_view mesh, bool start) {
  const absl::StatusOr<EntryPointer> entry = directory_.catalog().Find(mesh);
  if (!entry.ok()) return entry.status();
  return (*entry)->Watch(start);
}

absl::StatusOr<StoredStatistics> Store::Statistics(absl::string_view mesh) const {
  const absl::StatusOr<EntryPointer> entry = directory_.Find(mesh);
  if (!entry.ok()) return entry.status();
  return (*entry)->Statistics();
}

StoreUsage Store::Usage() const {
  StoreUsage usage;
  for (const EntryPointer& entry : directory_.catalog().List("", SIZE_MAX)) entry->AddUsage(&usage);
  usage.disk_bytes = directory_.catalog().totals().stored_bytes;
  usage.directory_writable = directory_.is_writable();
  usage.budget_bytes = tree_budget_->used();
  usage.budget_limit = tree_budget_->limit();
  usage.builds_waiting = queue_.waiting();
  usage.builds_running = queue_.running();
  return usage;
}

}  // namespace

absl::StatusOr<std::unique_ptr<MeshStore>> MeshStore::Open(Options options) {
  DataDirectory::Changes contents;
  absl::StatusOr<DataDirectory> directory =
      DataDirectory::Open(options.data_directory, options.change_timeout, &contents);
  if (!directory.ok()) return directory.status();
  return std::make_unique<Store>(std::move(options), *std::move(directory), std::move(contents));
}

}  // namespace deltaray
