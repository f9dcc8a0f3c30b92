#include <set>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/build/mutex.h"
#include "server/store/durable_file.h"
#include "server/store/mesh_name.h"
#include "server/store/record_file.h"
#include "server/store/store.h"
#include "spdlog/spdlog.h"

namespace deltaray {

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

}  // namespace deltaray
