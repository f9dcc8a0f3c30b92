#include "server/store/mesh_store.h"

#include <map>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/build/mutex.h"
#include "server/store/build_queue.h"
#include "server/store/build_run.h"
#include "server/store/data_directory.h"
#include "server/store/durable_file.h"
#include "server/store/mesh_entry.h"
#include "server/store/mesh_name.h"
#include "server/store/new_mesh.h"
#include "server/store/record_file.h"
#include "server/store/upload_file.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

class Store final : public MeshStore {
 public:
  Store(Options options, DataDirectory directory, DataDirectory::Contents contents);
  ~Store() override;

  absl::StatusOr<std::unique_ptr<Upload>> StartUpload() override;
  absl::StatusOr<MeshInfo> Get(absl::string_view mesh) const override;
  std::vector<MeshInfo> List(absl::string_view after_id, size_t limit) const override;
  absl::StatusOr<std::string> Name(absl::string_view name, absl::string_view mesh) override;
  absl::StatusOr<std::string> Delete(absl::string_view mesh) override;
  absl::StatusOr<MeshInfo> Rebuild(absl::string_view mesh, const Config& config) override;
  void WithTree(absl::string_view mesh, bool final, std::function<void(absl::StatusOr<Answer>)> callback) override;
  void StopWaiting(const absl::Status& status) override;
  void NoteAnswer(const Answer& answer) override;
  absl::StatusOr<BuildReport> Watch(absl::string_view mesh) override;
  absl::StatusOr<StoredStatistics> Statistics(absl::string_view mesh) const override;
  StoreUsage Usage() const override;

  const Options& options() const { return options_; }
  // Stores an upload's mesh, or finds that it is there already.
  absl::StatusOr<Upload::Committed> Put(const NewMesh& upload);

 private:
  struct Stored {
    std::shared_ptr<MeshEntry> entry;
    std::set<std::string> names;

    // Without groups.
    MeshInfo Info() const {
      MeshInfo info = entry->Info();
      info.names.assign(names.begin(), names.end());
      return info;
    }
  };

  // The mesh of an id or a name.
  absl::StatusOr<Stored> Find(absl::string_view mesh) const;
  // The mesh of an id, where its file is there, as far as is known.
  std::shared_ptr<MeshEntry> FindWhole(const std::string& id) const;
  // The mesh first, and the name last: whenever the server dies, no config or name is without its mesh.
  absl::Status MoveFiles(const NewMesh& upload, PreparedFiles& files) ABSL_EXCLUSIVE_LOCKS_REQUIRED(disk_mutex_);
  absl::Status RemoveMeshFiles(const std::string& id) ABSL_EXCLUSIVE_LOCKS_REQUIRED(disk_mutex_);
  std::vector<std::shared_ptr<MeshEntry>> Entries() const;
  // Points a name at a mesh, in memory; with an empty id takes it away. Returns the id it pointed at before.
  std::string MoveName(const std::string& name, const std::string& id) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const Options options_;
  const DataDirectory directory_;
  BuildQueue queue_;

  // Held by whoever changes the directory, so that disk and memory change in the same order. Readers do without.
  Mutex disk_mutex_ ABSL_ACQUIRED_BEFORE(mutex_);
  mutable Mutex mutex_;
  std::map<std::string, Stored, std::less<>> meshes_ ABSL_GUARDED_BY(mutex_);
  std::map<std::string, std::string, std::less<>> names_ ABSL_GUARDED_BY(mutex_);
  absl::Status no_waiting_ ABSL_GUARDED_BY(mutex_);  // of StopWaiting, for entries to come
};

class StoreUpload final : public Upload {
 public:
  StoreUpload(Store* store, UploadFile file) : store_(store), file_(std::move(file)) {}

  absl::Status Append(absl::string_view bytes) override { return file_.Append(bytes); }
  uint64_t size() const override { return file_.size(); }

  absl::StatusOr<Committed> Commit(CommitOptions options) override {
    // The upload's bytes are gone before the mesh is written, which may need their room.
    const absl::StatusOr<NewMesh> mesh = ReadNewMesh(std::move(file_), options, store_->options().mesh_limits);
    if (!mesh.ok()) return mesh.status();
    return store_->Put(*mesh);
  }

 private:
  Store* const store_;
  UploadFile file_;
};

Store::Store(Options options, DataDirectory directory, DataDirectory::Contents contents)
    : options_(std::move(options)),
      directory_(std::move(directory)),
      queue_(options_.concurrent_builds,
             {.config = {}, .threads = options_.build_threads, .on_delta_leaf = options_.on_delta_leaf},
             options_.on_build_end) {
  MutexLock lock(mutex_);
  for (MeshInfo& info : contents.meshes) {
    const std::string id = info.id;
    meshes_[id].entry = std::make_shared<MeshEntry>(std::move(info), directory_.MeshPath(id), &queue_);
  }
  for (const NameRecord& record : contents.names) MoveName(record.name, record.id);
}

Store::~Store() {
  for (const auto& entry : Entries()) entry->Close(absl::UnavailableError("the server is shutting down"));
  queue_.Stop();
}

absl::StatusOr<std::unique_ptr<Upload>> Store::StartUpload() {
  absl::StatusOr<UploadFile> file = UploadFile::Create(directory_.TemporariesPath(), options_.max_upload_bytes);
  if (!file.ok()) return file.status();
  return std::make_unique<StoreUpload>(this, *std::move(file));
}

absl::StatusOr<Upload::Committed> Store::Put(const NewMesh& upload) {
  const std::string& id = upload.info.id;
  PreparedFiles files;
  if (absl::Status status = files.PrepareLabels(upload, directory_); !status.ok()) return status;
  for (;;) {
    // Write a mesh that is new without the lock: it may be large.
    if (!files.mesh && !FindWhole(id)) {
      if (absl::Status status = files.PrepareMesh(upload, directory_); !status.ok()) return status;
    }
    if (upload.cancelled && upload.cancelled()) return absl::CancelledError("the upload was cancelled");

    MutexLock disk_lock(disk_mutex_);
    std::shared_ptr<MeshEntry> entry = FindWhole(id);
    if (!entry && !files.mesh) continue;  // deleted since
    if (entry) files.mesh.reset();        // stored since, or long ago
    const bool same_config = entry && (!upload.config || EncodeConfig(*upload.config) == EncodeConfig(entry->config()));
    if (same_config) files.config.reset();
    Upload::Committed committed;
    committed.created = !Find(id).ok();
    if (absl::Status status = MoveFiles(upload, files); !status.ok()) {
      if (committed.created) RemoveMeshFiles(id).IgnoreError();
      return status;
    }

    Stored stored;
    const bool is_new = !entry;  // to memory: the mesh of a lost file is so again
    {
      MutexLock lock(mutex_);
      Stored& slot = meshes_[id];
      if (is_new) {
        MeshInfo info = upload.info;
        info.config = upload.config ? *upload.config : slot.entry ? slot.entry->config() : Config();
        slot.entry = entry = std::make_shared<MeshEntry>(std::move(info), directory_.MeshPath(id), &queue_);
        if (!no_waiting_.ok()) entry->StopWaiting(no_waiting_);
      }
      if (!upload.name.empty()) MoveName(upload.name, id);
      stored = slot;
    }
    spdlog::info("{} mesh {}: {} triangles{}{}", committed.created ? "stored" : "found again", id,
                 upload.info.triangle_count, upload.name.empty() ? "" : ", named ", upload.name);
    if (is_new || same_config) {
      entry->Start(upload.mesh);
    } else {
      entry->Rebuild(*upload.config, upload.mesh);
    }
    committed.info = stored.Info();
    committed.info.groups = entry->groups();
    return committed;
  }
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
  const absl::StatusOr<Stored> stored = Find(mesh);
  if (!stored.ok()) return stored.status();
  MeshInfo info = stored->Info();
  info.groups = stored->entry->groups();
  return info;
}

std::vector<MeshInfo> Store::List(absl::string_view after_id, size_t limit) const {
  std::vector<Stored> page;
  {
    MutexLock lock(mutex_);
    for (auto it = meshes_.upper_bound(after_id); it != meshes_.end() && page.size() < limit; ++it) {
      page.push_back(it->second);
    }
  }
  std::vector<MeshInfo> infos;
  for (const Stored& stored : page) infos.push_back(stored.Info());
  return infos;
}

absl::StatusOr<std::string> Store::Name(absl::string_view name, absl::string_view mesh) {
  if (absl::Status status = ValidateMeshName(name); !status.ok()) return status;
  const std::string label(name);
  const std::string path = directory_.NamePath(label);

  MutexLock disk_lock(disk_mutex_);
  std::string id;
  if (mesh.empty()) {
    if (absl::StatusOr<Stored> named = Find(name); !named.ok()) return named.status();
    if (absl::Status status = RemoveFile(path); !status.ok()) return status;
  } else {
    const absl::StatusOr<Stored> target = Find(mesh);
    if (!target.ok()) return target.status();
    id = target->entry->id();
    if (target->names.count(label) != 0) return id;
    absl::StatusOr<TemporaryFile> file = directory_.Prepare(EncodeName({label, id}));
    if (!file.ok()) return file.status();
    if (absl::Status status = file->MoveTo(path); !status.ok()) return status;
  }
  std::string previous;
  {
    MutexLock lock(mutex_);
    previous = MoveName(label, id);
  }
  if (id.empty()) {
    spdlog::info("took the name {} away from mesh {}", label, previous);
  } else {
    spdlog::info("named mesh {} {}", id, label);
  }
  return previous;
}

absl::StatusOr<std::string> Store::Delete(absl::string_view mesh) {
  std::shared_ptr<MeshEntry> entry;
  {
    MutexLock disk_lock(disk_mutex_);
    const absl::StatusOr<Stored> stored = Find(mesh);
    if (!stored.ok()) return stored.status();
    entry = stored->entry;
    // Names first, then config, then mesh, for the same reason as in MoveFiles.
    for (const std::string& name : stored->names) {
      if (absl::Status status = RemoveFile(directory_.NamePath(name)); !status.ok()) return status;
      MutexLock lock(mutex_);
      MoveName(name, "");
    }
    if (absl::Status status = RemoveMeshFiles(entry->id()); !status.ok()) return status;
    MutexLock lock(mutex_);
    meshes_.erase(entry->id());
  }
  spdlog::info("deleted mesh {}", entry->id());
  entry->Close(absl::NotFoundError(absl::StrCat("mesh ", entry->id(), " was deleted")));
  return entry->id();
}

absl::Status Store::RemoveMeshFiles(const std::string& id) {
  if (absl::Status status = RemoveFile(directory_.ConfigPath(id)); !status.ok()) return status;
  return RemoveFile(directory_.MeshPath(id));
}

absl::StatusOr<MeshInfo> Store::Rebuild(absl::string_view mesh, const Config& config) {
  if (absl::Status status = Validate(config); !status.ok()) return status;
  std::string id;
  {
    MutexLock disk_lock(disk_mutex_);
    const absl::StatusOr<Stored> stored = Find(mesh);
    if (!stored.ok()) return stored.status();
    id = stored->entry->id();
    absl::StatusOr<TemporaryFile> file = directory_.Prepare(EncodeConfig(config));
    if (!file.ok()) return file.status();
    if (absl::Status status = file->MoveTo(directory_.ConfigPath(id)); !status.ok()) return status;
    stored->entry->Rebuild(config, nullptr);
  }
  return Get(id);
}

void Store::WithTree(absl::string_view mesh, bool final, std::function<void(absl::StatusOr<Answer>)> callback) {
  const absl::StatusOr<Stored> stored = Find(mesh);
  if (!stored.ok()) return callback(stored.status());
  stored->entry->WithTree(final, std::move(callback));
}

void Store::StopWaiting(const absl::Status& status) {
  {
    MutexLock lock(mutex_);
    no_waiting_ = status;
  }
  for (const auto& entry : Entries()) entry->StopWaiting(status);
}

void Store::NoteAnswer(const Answer& answer) {
  if (answer.first_answer) answer.first_answer->Note();
}

absl::StatusOr<BuildReport> Store::Watch(absl::string_view mesh) {
  const absl::StatusOr<Stored> stored = Find(mesh);
  if (!stored.ok()) return stored.status();
  return stored->entry->Watch();
}

absl::StatusOr<StoredStatistics> Store::Statistics(absl::string_view mesh) const {
  const absl::StatusOr<Stored> stored = Find(mesh);
  if (!stored.ok()) return stored.status();
  return stored->entry->Statistics();
}

StoreUsage Store::Usage() const {
  StoreUsage usage;
  for (const auto& entry : Entries()) entry->AddUsage(&usage);
  usage.builds_waiting = queue_.waiting();
  usage.builds_running = queue_.running();
  return usage;
}

absl::StatusOr<Store::Stored> Store::Find(absl::string_view mesh) const {
  MutexLock lock(mutex_);
  absl::string_view id = mesh;
  if (!IsMeshId(mesh)) {
    // A name that may not be one is not repeated in the text.
    if (!ValidateMeshName(mesh).ok()) return absl::NotFoundError("no mesh: neither a mesh id nor a valid name");
    const auto name = names_.find(mesh);
    if (name == names_.end()) return absl::NotFoundError(absl::StrCat("no mesh is named ", mesh));
    id = name->second;
  }
  const auto stored = meshes_.find(id);
  if (stored == meshes_.end()) return absl::NotFoundError(absl::StrCat("no mesh has the id ", id));
  return stored->second;
}

std::shared_ptr<MeshEntry> Store::FindWhole(const std::string& id) const {
  const absl::StatusOr<Stored> stored = Find(id);
  return stored.ok() && !stored->entry->file_is_lost() ? stored->entry : nullptr;
}

std::vector<std::shared_ptr<MeshEntry>> Store::Entries() const {
  std::vector<std::shared_ptr<MeshEntry>> entries;
  MutexLock lock(mutex_);
  for (const auto& [id, stored] : meshes_) entries.push_back(stored.entry);
  return entries;
}

std::string Store::MoveName(const std::string& name, const std::string& id) {
  std::string previous;
  if (const auto it = names_.find(name); it != names_.end()) {
    previous = it->second;
    meshes_.find(previous)->second.names.erase(name);
    names_.erase(it);
  }
  if (!id.empty()) {
    names_.emplace(name, id);
    meshes_.find(id)->second.names.insert(name);
  }
  return previous;
}

}  // namespace

absl::StatusOr<std::unique_ptr<MeshStore>> MeshStore::Open(Options options) {
  DataDirectory::Contents contents;
  absl::StatusOr<DataDirectory> directory = DataDirectory::Open(options.data_directory, &contents);
  if (!directory.ok()) return directory.status();
  return std::make_unique<Store>(std::move(options), *std::move(directory), std::move(contents));
}

}  // namespace deltaray
