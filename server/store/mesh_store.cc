#include "server/store/mesh_store.h"

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <set>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/build/mutex.h"
#include "server/store/build_queue.h"
#include "server/store/build_run.h"
#include "server/store/catalog.h"
#include "server/store/data_directory.h"
#include "server/store/disk_budget.h"
#include "server/store/durable_file.h"
#include "server/store/mesh_entry.h"
#include "server/store/mesh_name.h"
#include "server/store/new_mesh.h"
#include "server/store/record_file.h"
#include "server/store/tree_budget.h"
#include "server/store/upload_file.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

// How often temporaries of servers that died are looked for.
constexpr std::chrono::minutes kSweepInterval{1};

using EntryPointer = std::shared_ptr<MeshEntry>;

// Entries whose meshes turned out to be deleted. Their waiters are told at the end: make it before a lock is taken.
class Dropped {
 public:
  ~Dropped() {
    for (const EntryPointer& entry : entries_) {
      entry->Close(absl::NotFoundError(absl::StrCat("mesh ", entry->id(), " was deleted")));
    }
  }
  void Add(EntryPointer entry) {
    if (entry) entries_.push_back(std::move(entry));
  }

 private:
  std::vector<EntryPointer> entries_;
};

class Store final : public MeshStore {
 public:
  Store(Options options, DataDirectory directory, DataDirectory::Changes contents);
  ~Store() override;

  absl::StatusOr<std::unique_ptr<Upload>> StartUpload() override;
  absl::StatusOr<MeshInfo> Get(absl::string_view mesh) const override;
  std::vector<MeshInfo> List(absl::string_view after_id, size_t limit) const override;
  absl::StatusOr<std::string> Name(absl::string_view name, absl::string_view mesh) override;
  absl::StatusOr<std::string> Delete(absl::string_view mesh) override;
  absl::StatusOr<MeshInfo> Rebuild(absl::string_view mesh, const Config& config) override;
  void WithTree(absl::string_view mesh, bool final, std::function<void(absl::StatusOr<Answer>)> callback) override;
  void StopWaiting(const absl::Status& status) override { catalog_.StopWaiting(status); }
  void NoteAnswer(const Answer& answer) override;
  absl::StatusOr<BuildReport> Watch(absl::string_view mesh) override;
  absl::StatusOr<StoredStatistics> Statistics(absl::string_view mesh) const override;
  StoreUsage Usage() const override;

  const Options& options() const { return options_; }
  std::shared_ptr<TreeBudget::Reservation> NewReservation() { return tree_budget_->Empty(); }
  // Stores an upload's mesh, or finds that it is there already.
  absl::StatusOr<Upload::Committed> Put(const NewMesh& upload);

 private:
  // The mesh of an id or a name; looked for on disk where it is not known yet.
  absl::StatusOr<EntryPointer> Find(absl::string_view mesh) const;
  MeshInfo InfoWithGroups(const MeshEntry& entry) const;

  // Each brings what is known up to date with the disk: of one mesh, of one name, of all. They return what is there;
  // NOT_FOUND where there is nothing.
  absl::StatusOr<EntryPointer> ReadMesh(const std::string& id, Dropped* dropped) const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(disk_mutex_);
  absl::StatusOr<std::string> ReadName(const std::string& name) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(disk_mutex_);
  absl::Status ReadAll(Dropped* dropped) ABSL_EXCLUSIVE_LOCKS_REQUIRED(disk_mutex_);
  void Take(DataDirectory::Changes changes, Dropped* dropped) ABSL_EXCLUSIVE_LOCKS_REQUIRED(disk_mutex_);
  // Catalog::MoveName of what was read or written without a look at the whole directory.
  std::string MoveName(const std::string& name, const std::string& id) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(disk_mutex_);
  EntryPointer TakeMesh(MeshInfo info) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(disk_mutex_);
  // ReadMesh of an id or a name.
  absl::StatusOr<EntryPointer> ReadTarget(absl::string_view mesh, Dropped* dropped) const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(disk_mutex_);

  // The mesh, where its file is there and not known to be damaged.
  EntryPointer FindWhole(const std::string& id, Dropped* dropped) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(disk_mutex_);
  bool IsWhole(const std::string& id) const;
  // The mesh first, and the name last: whenever the server dies, no config or name is without its mesh.
  absl::Status MoveFiles(const NewMesh& upload, PreparedFiles& files) ABSL_EXCLUSIVE_LOCKS_REQUIRED(disk_mutex_);
  absl::Status RemoveMeshFiles(const std::string& id) ABSL_EXCLUSIVE_LOCKS_REQUIRED(disk_mutex_);

  // Whether an upload may add what it adds.
  absl::Status CheckLimits(const NewMesh& upload, bool is_new) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(disk_mutex_);
  absl::Status CheckNameLimits(const std::string& name, const std::string& id) const;
  EntryPointer MakeEntry(MeshInfo info) const;
  // Drops the tree that nobody has asked for for longest. False: there is none that can be dropped.
  bool DropATree() const;

  // Notices what other servers change, until the end.
  void Follow();

  const Options options_;
  mutable BuildQueue queue_;  // outlives the entries
  const std::shared_ptr<TreeBudget> tree_budget_;
  mutable Catalog catalog_;
  DiskBudget disk_budget_;

  // Held by whoever changes the directory, for as long as it waits for the other servers and acts.
  Mutex change_mutex_ ABSL_ACQUIRED_BEFORE(disk_mutex_);
  // Held while the directory is read or changed and the catalog with it, so that both change in the same order.
  mutable Mutex disk_mutex_;
  mutable DataDirectory directory_;  // its Look is guarded by disk_mutex_

  Mutex stop_mutex_;
  Condition stop_changed_;
  bool stopped_ ABSL_GUARDED_BY(stop_mutex_) = false;
  std::thread follower_;
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
      tree_budget_(std::make_shared<TreeBudget>(options_.tree_bytes, [this] { return DropATree(); })),
      disk_budget_(options_.max_stored_bytes, [this] { return catalog_.totals().stored_bytes; }),
      directory_(std::move(directory)) {
  {
    Dropped none;
    MutexLock disk_lock(disk_mutex_);
    Take(std::move(contents), &none);
  }
  follower_ = std::thread([this] { Follow(); });
}

Store::~Store() {
  {
    MutexLock lock(stop_mutex_);
    stopped_ = true;
    stop_changed_.notify_all();
  }
  follower_.join();
  for (const EntryPointer& entry : catalog_.List("", SIZE_MAX)) {
    entry->Close(absl::UnavailableError("the server is shutting down"));
  }
  queue_.Stop();
}

absl::StatusOr<std::unique_ptr<Upload>> Store::StartUpload() {
  absl::StatusOr<UploadFile> file =
      UploadFile::Create(directory_.TemporariesPath(), options_.max_upload_bytes, &disk_budget_);
  if (!file.ok()) return file.status();
  return std::make_unique<StoreUpload>(this, *std::move(file));
}

absl::StatusOr<Upload::Committed> Store::Put(const NewMesh& upload) {
  const std::string& id = upload.info.id;
  PreparedFiles files(&disk_budget_);
  if (absl::Status status = files.PrepareLabels(upload, directory_); !status.ok()) return status;
  for (;;) {
    // Write a mesh that is new without the lock: it may be large.
    if (!files.mesh && !IsWhole(id)) {
      if (absl::Status status = files.PrepareMesh(upload, directory_); !status.ok()) return status;
    }
    if (upload.cancelled && upload.cancelled()) return absl::CancelledError("the upload was cancelled");

    Dropped dropped;
    MutexLock change_lock(change_mutex_);
    const absl::StatusOr<FileDescriptor> lock = directory_.Lock();
    if (!lock.ok()) return lock.status();
    MutexLock disk_lock(disk_mutex_);
    EntryPointer entry = FindWhole(id, &dropped);
    if (!entry && !files.mesh) continue;  // deleted since
    if (entry) files.mesh.reset();        // stored since, or long ago
    const bool same_config = entry && (!upload.config || EncodeConfig(*upload.config) == EncodeConfig(entry->config()));
    if (same_config) files.config.reset();
    Upload::Committed committed;
    committed.created = !catalog_.Find(id).ok();
    if (absl::Status status = CheckLimits(upload, committed.created); !status.ok()) return status;
    if (absl::Status status = MoveFiles(upload, files); !status.ok()) {
      if (committed.created) RemoveMeshFiles(id).IgnoreError();
      return status;
    }

    const bool is_new = !entry;  // to memory: the mesh of a lost file is so again
    if (is_new) {
      MeshInfo info = upload.info;
      const absl::StatusOr<Config> kept = directory_.ReadConfig(id);
      info.config = upload.config ? *upload.config : kept.ok() ? *kept : Config();
      entry = MakeEntry(std::move(info));
      directory_.TellOfMesh(id);
      catalog_.Put(entry);
    }
    if (!upload.name.empty()) MoveName(upload.name, id);
    spdlog::info("{} mesh {}: {} triangles{}{}", committed.created ? "stored" : "found again", id,
                 upload.info.triangle_count, upload.name.empty() ? "" : ", named ", upload.name);
    // Where the queue is full, the mesh is stored all the same, and built when it is asked for.
    if (is_new || same_config) {
      entry->Start(upload.loaded);
    } else {
      entry->Rebuild(*upload.config, upload.loaded).IgnoreError();
    }
    committed.info = InfoWithGroups(*entry);
    return committed;
  }
}

absl::Status Store::CheckLimits(const NewMesh& upload, bool is_new) const {
  if (is_new && catalog_.totals().meshes >= options_.max_meshes) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the limit of ", options_.max_meshes, " meshes is met (max_meshes)"));
  }
  if (upload.name.empty()) return absl::OkStatus();
  ReadName(upload.name).IgnoreError();
  return CheckNameLimits(upload.name, upload.info.id);
}

absl::Status Store::CheckNameLimits(const std::string& name, const std::string& id) const {
  const std::set<std::string> names = catalog_.NamesOf(id);
  if (names.count(name) != 0) return absl::OkStatus();
  if (names.size() >= options_.max_names_per_mesh) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the limit of ", options_.max_names_per_mesh, " names of one mesh is met (max_names_per_mesh)"));
  }
  if (catalog_.totals().names >= options_.max_names && !catalog_.HasName(name)) {
    return absl::ResourceExhaustedError(absl::StrCat("the limit of ", options_.max_names, " names is met (max_names)"));
  }
  return absl::OkStatus();
}

EntryPointer Store::MakeEntry(MeshInfo info) const {
  std::string path = directory_.MeshPath(info.id);
  return std::make_shared<MeshEntry>(std::move(info), std::move(path), &queue_, tree_budget_.get());
}

bool Store::DropATree() const {
  std::vector<EntryPointer> entries = catalog_.List("", SIZE_MAX);
  std::vector<std::pair<std::chrono::steady_clock::time_point, MeshEntry*>> by_use;
  for (const EntryPointer& entry : entries) by_use.emplace_back(entry->last_used(), entry.get());
  std::sort(by_use.begin(), by_use.end());
  for (const auto& [used, entry] : by_use) {
    if (!entry->Drop()) continue;
    spdlog::info("dropped the tree of mesh {} to make room", entry->id());
    return true;
  }
  return false;
}

absl::Status Store::MoveFiles(const NewMesh& upload, PreparedFiles& files) {
  const std::string& id = upload.info.id;
  absl::Status status;
  if (files.mesh) status = files.mesh->MoveTo(directory_.MeshPath(id));
  if (status.ok() && files.config) status = files.config->MoveTo(directory_.ConfigPath(id));
  if (status.ok() && files.name) status = files.name->MoveTo(directory_.NamePath(upload.name));
  return status;
}

absl::StatusOr<MeshInfo> Store::Get(absl::string_view mesh) const {
  const absl::StatusOr<EntryPointer> entry = Find(mesh);
  if (!entry.ok()) return entry.status();
  return InfoWithGroups(**entry);
}

MeshInfo Store::InfoWithGroups(const MeshEntry& entry) const {
  MeshInfo info = catalog_.Info(entry);
  info.groups = entry.groups();
  return info;
}

std::vector<MeshInfo> Store::List(absl::string_view after_id, size_t limit) const {
  std::vector<MeshInfo> infos;
  for (const EntryPointer& entry : catalog_.List(after_id, limit)) infos.push_back(catalog_.Info(*entry));
  return infos;
}

absl::StatusOr<std::string> Store::Name(absl::string_view name, absl::string_view mesh) {
  if (absl::Status status = ValidateMeshName(name); !status.ok()) return status;
  const std::string label(name);
  const std::string path = directory_.NamePath(label);

  Dropped dropped;
  MutexLock change_lock(change_mutex_);
  const absl::StatusOr<FileDescriptor> lock = directory_.Lock();
  if (!lock.ok()) return lock.status();
  MutexLock disk_lock(disk_mutex_);
  const absl::StatusOr<std::string> pointed = ReadName(label);
  std::string id;
  if (mesh.empty()) {
    if (absl::IsNotFound(pointed.status())) return absl::NotFoundError(absl::StrCat("no mesh is named ", name));
    if (absl::Status status = RemoveFile(path); !status.ok()) return status;
  } else {
    const absl::StatusOr<EntryPointer> target = ReadTarget(mesh, &dropped);
    if (!target.ok()) return target.status();
    id = (*target)->id();
    if (pointed.ok() && *pointed == id) return id;
    if (absl::Status status = CheckNameLimits(label, id); !status.ok()) return status;
    absl::StatusOr<TemporaryFile> file = directory_.Prepare(EncodeName({label, id}));
    if (!file.ok()) return file.status();
    if (absl::Status status = file->MoveTo(path); !status.ok()) return status;
  }
  const std::string previous = MoveName(label, id);
  if (id.empty()) {
    spdlog::info("took the name {} away from mesh {}", label, previous);
  } else {
    spdlog::info("named mesh {} {}", id, label);
  }
  return previous;
}

absl::StatusOr<std::string> Store::Delete(absl::string_view mesh) {
  Dropped dropped;
  MutexLock change_lock(change_mutex_);
  const absl::StatusOr<FileDescriptor> lock = directory_.Lock();
  if (!lock.ok()) return lock.status();
  MutexLock disk_lock(disk_mutex_);
  // Other servers may have given it names.
  if (absl::Status status = ReadAll(&dropped); !status.ok()) return status;
  std::string id(mesh);
  const absl::StatusOr<EntryPointer> entry = ReadTarget(mesh, &dropped);
  if (entry.ok()) {
    id = (*entry)->id();
  } else if (!IsMeshId(mesh) || !directory_.HasMesh(mesh)) {
    return entry.status();
  }
  // Names first, then config, then mesh, for the same reason as in MoveFiles.
  for (const std::string& name : catalog_.NamesOf(id)) {
    if (absl::Status status = RemoveFile(directory_.NamePath(name)); !status.ok()) return status;
    catalog_.MoveName(name, "");
  }
  if (absl::Status status = RemoveMeshFiles(id); !status.ok()) return status;
  dropped.Add(catalog_.Remove(id));
  spdlog::info("deleted mesh {}", id);
  return id;
}

absl::Status Store::RemoveMeshFiles(const std::string& id) {
  if (absl::Status status = RemoveFile(directory_.ConfigPath(id)); !status.ok()) return status;
  return RemoveFile(directory_.MeshPath(id));
}

absl::StatusOr<MeshInfo> Store::Rebuild(absl::string_view mesh, const Config& config) {
  if (absl::Status status = Validate(config); !status.ok()) return status;
  Dropped dropped;
  MutexLock change_lock(change_mutex_);
  const absl::StatusOr<FileDescriptor> lock = directory_.Lock();
  if (!lock.ok()) return lock.status();
  MutexLock disk_lock(disk_mutex_);
  const absl::StatusOr<EntryPointer> entry = ReadTarget(mesh, &dropped);
  if (!entry.ok()) return entry.status();
  if (absl::Status status = queue_.CheckRoom(); !status.ok()) return status;
  absl::StatusOr<TemporaryFile> file = directory_.Prepare(EncodeConfig(config));
  if (!file.ok()) return file.status();
  if (absl::Status status = file->MoveTo(directory_.ConfigPath((*entry)->id())); !status.ok()) return status;
  if (absl::Status status = (*entry)->Rebuild(config, {}); !status.ok()) return status;
  return InfoWithGroups(**entry);
}

void Store::WithTree(absl::string_view mesh, bool final, std::function<void(absl::StatusOr<Answer>)> callback) {
  const absl::StatusOr<EntryPointer> entry = Find(mesh);
  if (!entry.ok()) return callback(entry.status());
  (*entry)->WithTree(final, std::move(callback));
}

void Store::NoteAnswer(const Answer& answer) {
  if (answer.first_answer) answer.first_answer->Note();
}

absl::StatusOr<BuildReport> Store::Watch(absl::string_view mesh) {
  const absl::StatusOr<EntryPointer> entry = Find(mesh);
  if (!entry.ok()) return entry.status();
  return (*entry)->Watch();
}

absl::StatusOr<StoredStatistics> Store::Statistics(absl::string_view mesh) const {
  const absl::StatusOr<EntryPointer> entry = Find(mesh);
  if (!entry.ok()) return entry.status();
  return (*entry)->Statistics();
}

StoreUsage Store::Usage() const {
  StoreUsage usage;
  for (const EntryPointer& entry : catalog_.List("", SIZE_MAX)) entry->AddUsage(&usage);
  usage.disk_bytes = catalog_.totals().stored_bytes;
  usage.budget_bytes = tree_budget_->used();
  usage.budget_limit = tree_budget_->limit();
  usage.builds_waiting = queue_.waiting();
  usage.builds_running = queue_.running();
  return usage;
}

absl::StatusOr<EntryPointer> Store::Find(absl::string_view mesh) const {
  absl::StatusOr<EntryPointer> known = catalog_.Find(mesh);
  if (known.ok() || (!IsMeshId(mesh) && !ValidateMeshName(mesh).ok())) return known;
  Dropped dropped;
  MutexLock disk_lock(disk_mutex_);
  return ReadTarget(mesh, &dropped);
}

absl::StatusOr<EntryPointer> Store::ReadTarget(absl::string_view mesh, Dropped* dropped) const {
  std::string id(mesh);
  if (!IsMeshId(mesh)) {
    absl::StatusOr<std::string> pointed = ValidateMeshName(mesh).ok() ? ReadName(id) : absl::NotFoundError("");
    if (absl::IsNotFound(pointed.status())) return catalog_.Find(mesh).status();
    if (!pointed.ok()) return pointed.status();
    id = *std::move(pointed);
  }
  absl::StatusOr<EntryPointer> entry = ReadMesh(id, dropped);
  return absl::IsNotFound(entry.status()) ? catalog_.Find(mesh) : entry;
}

absl::StatusOr<EntryPointer> Store::ReadMesh(const std::string& id, Dropped* dropped) const {
  absl::StatusOr<MeshInfo> info = directory_.ReadMesh(id);
  if (info.ok()) {
    directory_.TellOfMesh(id);
    return TakeMesh(*std::move(info));
  }
  if (absl::IsNotFound(info.status())) {
    dropped->Add(catalog_.Remove(id));
  } else if (absl::StatusOr<EntryPointer> known = catalog_.Find(id); known.ok()) {
    return known;  // what was read of it before is right
  }
  return info.status();
}

absl::StatusOr<std::string> Store::ReadName(const std::string& name) const {
  absl::StatusOr<std::string> id = directory_.ReadName(name);
  if (id.ok() || absl::IsNotFound(id.status())) MoveName(name, id.ok() ? *id : "");
  return id;
}

EntryPointer Store::TakeMesh(MeshInfo info) const {
  if (const absl::StatusOr<EntryPointer> known = catalog_.Find(info.id); known.ok()) {
    (*known)->SetConfig(info.config);
    return *known;
  }
  EntryPointer entry = MakeEntry(std::move(info));
  catalog_.Put(entry);
  return entry;
}

absl::Status Store::ReadAll(Dropped* dropped) {
  DataDirectory::Changes changes;
  const absl::Status status = directory_.Look(&changes);
  Take(std::move(changes), dropped);
  return status;
}

std::string Store::MoveName(const std::string& name, const std::string& id) const {
  if (!id.empty()) directory_.TellOfName(name);
  return catalog_.MoveName(name, id);
}

void Store::Take(DataDirectory::Changes changes, Dropped* dropped) {
  for (MeshInfo& info : changes.meshes) TakeMesh(std::move(info));
  for (const std::string& id : changes.gone_meshes) dropped->Add(catalog_.Remove(id));
  for (const auto& [id, config] : changes.configs) {
    if (const absl::StatusOr<EntryPointer> entry = catalog_.Find(id); entry.ok()) (*entry)->SetConfig(config);
  }
  for (const NameRecord& record : changes.names) {
    catalog_.MoveName(record.name, record.id);
    // The mesh may have come after meshes were looked at.
    if (!catalog_.Find(record.id).ok()) ReadMesh(record.id, dropped).IgnoreError();
  }
  for (const std::string& name : changes.gone_names) catalog_.MoveName(name, "");
}

EntryPointer Store::FindWhole(const std::string& id, Dropped* dropped) const {
  const absl::StatusOr<EntryPointer> entry = ReadMesh(id, dropped);
  return entry.ok() && directory_.HasMesh(id) && !(*entry)->file_is_lost() ? *entry : nullptr;
}

bool Store::IsWhole(const std::string& id) const {
  Dropped dropped;
  MutexLock disk_lock(disk_mutex_);
  return FindWhole(id, &dropped) != nullptr;
}

void Store::Follow() {
  using Clock = std::chrono::steady_clock;
  absl::Status last;
  Clock::time_point swept = Clock::now();
  for (;;) {
    const Clock::time_point begin = Clock::now();
    absl::Status status;
    {
      Dropped dropped;
      MutexLock disk_lock(disk_mutex_);
      status = ReadAll(&dropped);
    }
    if (status.code() != last.code()) {
      if (status.ok()) {
        spdlog::info("changes of other servers can be seen again");
      } else {
        spdlog::error("changes of other servers can not be seen: {}", status.ToString());
      }
    }
    last = status;
    if (begin - swept >= kSweepInterval) {
      swept = begin;
      RemoveAbandonedFiles(directory_.TemporariesPath());
    }
    // Where there is much to look at, a tenth of the time at most.
    const Clock::duration took = Clock::now() - begin;
    const Clock::time_point next = begin + std::max<Clock::duration>(options_.follow_interval, 10 * took);
    MutexLock lock(stop_mutex_);
    while (!stopped_ && Clock::now() < next) stop_changed_.wait_until(stop_mutex_, next);
    if (stopped_) return;
  }
}

}  // namespace

absl::StatusOr<std::unique_ptr<MeshStore>> MeshStore::Open(Options options) {
  DataDirectory::Changes contents;
  absl::StatusOr<DataDirectory> directory = DataDirectory::Open(options.data_directory, &contents);
  if (!directory.ok()) return directory.status();
  return std::make_unique<Store>(std::move(options), *std::move(directory), std::move(contents));
}

}  // namespace deltaray
