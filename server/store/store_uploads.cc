#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/build/mutex.h"
#include "server/store/build_memory.h"
#include "server/store/durable_file.h"
#include "server/store/record_file.h"
#include "server/store/store.h"
#include "server/store/upload_file.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

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

}  // namespace

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

}  // namespace deltaray
