#include "server/store/data_directory.h"

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <string_view>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/store/mesh_file.h"
#include "server/store/mesh_name.h"
#include "server/store/sha256.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

constexpr absl::string_view kFolders[] = {"meshes", "configs", "names", "tmp"};

bool Exists(const std::string& path) {
  std::error_code error;
  // What cannot be examined may be there.
  return std::filesystem::exists(path, error) || error;
}

// Whether a file cannot be read for what may pass: then it is not known what it holds.
bool MayPass(const absl::Status& status) {
  return !status.ok() && !absl::IsNotFound(status) && !absl::IsDataLoss(status) && !absl::IsFailedPrecondition(status);
}

void Drop(const std::string& path, std::string_view why) {
  if (absl::Status status = RemoveFile(path); status.ok()) {
    spdlog::info("removed {}: {}", path, why);
  } else {
    spdlog::warn("{}: {}, but {}", path, why, status.ToString());
  }
}

}  // namespace

DataDirectory::DataDirectory(const std::string& path)
    : path_(path),
      meshes_(path + "/meshes", ".mesh"),
      configs_(path + "/configs", ".config"),
      names_(path + "/names", ".name") {}

absl::StatusOr<DataDirectory> DataDirectory::Open(const std::string& path, std::chrono::milliseconds lock_timeout,
                                                  Changes* contents) {
  if (path.empty()) return absl::InvalidArgumentError("data_directory: is empty");
  for (const absl::string_view folder : kFolders) {
    if (absl::Status status = MakeFolder(absl::StrCat(path, "/", folder)); !status.ok()) return status;
  }
  DataDirectory directory(path);
  // Makes its file: the first to make it, as a back-up by another user, owns it. Where that cannot be, CheckWritable
  // tells.
  directory.Lock(std::chrono::milliseconds(0)).IgnoreError();
  if (const size_t removed = RemoveAbandonedFiles(directory.TemporariesPath()); removed > 0) {
    spdlog::info("removed {} temporaries that a dead server left in {}", removed, directory.TemporariesPath());
  }
  if (absl::Status status = directory.Look(contents); !status.ok()) return status;
  directory.RemoveStray(lock_timeout, contents);
  spdlog::info("opened data directory {}: {} meshes, {} names, {} files refused", path, contents->meshes.size(),
               contents->names.size(), directory.refused_.size());
  return directory;
}

absl::Status DataDirectory::Look(Changes* changes) {
  absl::Status status = LookAtMeshes(changes);
  status.Update(LookAtNames(changes));
  return status;
}

absl::Status DataDirectory::LookAtMeshes(Changes* changes) {
  absl::StatusOr<FolderWatch::Changes> configs = configs_.Look();
  absl::StatusOr<FolderWatch::Changes> meshes = meshes_.Look();
  const bool configs_are_told = configs.ok();
  absl::Status status = meshes.status();
  status.Update(configs.status());
  if (!meshes.ok()) meshes = FolderWatch::Changes();
  if (!configs.ok()) configs = FolderWatch::Changes();

  absl::flat_hash_set<std::string> read;
  for (const std::string& id : meshes->present) {
    absl::StatusOr<MeshInfo> info = ReadMesh(id);
    if (info.ok()) {
      refused_.erase(MeshPath(id));
      read.insert(id);
      changes->meshes.push_back(*std::move(info));
    } else if (!absl::IsNotFound(info.status()) && (Refuse(MeshPath(id), info.status()) || !configs_are_told)) {
      meshes_.TellOf(id);
    }
  }
  for (std::string& id : meshes->gone) {
    refused_.erase(MeshPath(id));
    changes->gone_meshes.push_back(std::move(id));
  }

  for (const std::string& id : configs->present) {
    const absl::StatusOr<Config> config = ReadConfig(id);
    if (config.ok()) {
      refused_.erase(ConfigPath(id));
    } else if (!absl::IsNotFound(config.status()) && Refuse(ConfigPath(id), config.status())) {
      configs_.TellOf(id);
    }
    // That of a mesh that was read was read with it.
    if (read.contains(id) || IsConfigUnknown(config.status())) continue;
    changes->configs.emplace_back(id, config.ok() ? *config : Config());
  }
  for (std::string& id : configs->gone) {
    refused_.erase(ConfigPath(id));
    if (!read.contains(id)) changes->configs.emplace_back(std::move(id), Config());
  }
  return status;
}

absl::Status DataDirectory::LookAtNames(Changes* changes) {
  const absl::StatusOr<FolderWatch::Changes> names = names_.Look();
  if (!names.ok()) return names.status();
  const auto take_away = [&](const std::string& digest) {
    const auto name = names_by_digest_.find(digest);
    if (name == names_by_digest_.end()) return;
    changes->gone_names.push_back(std::move(name->second));
    names_by_digest_.erase(name);
  };
  for (const std::string& digest : names->present) {
    const std::string path = NamePathOfDigest(digest);
    absl::StatusOr<NameRecord> record = ReadNameFile(digest);
    if (record.ok()) {
      refused_.erase(path);
      names_by_digest_[digest] = record->name;
      changes->names.push_back(*std::move(record));
    } else {
      if (!absl::IsNotFound(record.status()) && Refuse(path, record.status())) names_.TellOf(digest);
      take_away(digest);
    }
  }
  for (const std::string& digest : names->gone) {
    refused_.erase(NamePathOfDigest(digest));
    take_away(digest);
  }
  return absl::OkStatus();
}

void DataDirectory::TellOfMesh(const std::string& id) {
  meshes_.TellOf(id);
  configs_.TellOf(id);
}

void DataDirectory::TellOfName(const std::string& name) {
  const std::string digest = Sha256::Hex(name);
  names_by_digest_[digest] = name;
  names_.TellOf(digest);
}

void DataDirectory::RemoveStray(std::chrono::milliseconds lock_timeout, Changes* contents) const {
  absl::flat_hash_set<absl::string_view> ids;
  for (const MeshInfo& mesh : contents->meshes) ids.insert(mesh.id);
  const auto is_stray = [&](const std::string& id) { return !ids.contains(id) && !HasMesh(id); };
  const auto is_stray_name = [&](const NameRecord& record) { return is_stray(record.id); };
  const auto is_stray_config = [&](const auto& config) { return is_stray(config.first); };
  if (std::none_of(contents->names.begin(), contents->names.end(), is_stray_name) &&
      std::none_of(contents->configs.begin(), contents->configs.end(), is_stray_config)) {
    return;
  }
  const absl::StatusOr<FileDescriptor> lock = Lock(lock_timeout);
  if (!lock.ok())
    return spdlog::warn("names or configs without a mesh are left where they are: {}", lock.status().ToString());

  // Another server may have changed any of them since.
  std::erase_if(contents->names, [&](const NameRecord& record) {
    const absl::StatusOr<std::string> id = ReadName(record.name);
    if (!id.ok() || !is_stray(*id)) return false;
    Drop(NamePath(record.name), "a name of a mesh that is not there");
    return true;
  });
  for (const auto& config : contents->configs) {
    if (is_stray_config(config)) Drop(ConfigPath(config.first), "a config of a mesh that is not there");
  }
}

absl::Status DataDirectory::CheckWritable() const {
  absl::Status status = CheckLockable(LockPath());
  for (const absl::string_view folder : kFolders) {
    status.Update(deltaray::CheckWritable(absl::StrCat(path_, "/", folder)));
  }
  return status;
}

absl::StatusOr<FileDescriptor> DataDirectory::Lock(std::chrono::milliseconds timeout) const {
  absl::StatusOr<FileDescriptor> lock = LockFile(LockPath(), timeout);
  for (const absl::string_view folder : kFolders) {
    const std::string path = absl::StrCat(path_, "/", folder);
    if (lock.ok() && !Exists(path)) lock = FolderError(ENOENT, "find", path);
  }
  return lock;
}

absl::StatusOr<MeshInfo> DataDirectory::ReadMesh(const std::string& id) const {
  absl::StatusOr<MeshInfo> info = ReadMeshFileInfo(MeshPath(id));
  if (!info.ok()) return info.status();
  if (info->id != id)
    return absl::DataLossError(absl::StrCat("mesh file ", MeshPath(id), " holds a mesh of another id"));
  const absl::StatusOr<Config> config = ReadConfig(id);
  if (IsConfigUnknown(config.status())) return config.status();
  if (config.ok()) info->config = *config;
  return info;
}

absl::StatusOr<std::vector<std::string>> DataDirectory::ReadGroups(const std::string& id) const {
  return ReadMeshFileGroups(MeshPath(id), id);
}

bool DataDirectory::HasMesh(absl::string_view id) const { return Exists(MeshPath(id)) || !Exists(path_ + "/meshes"); }

absl::StatusOr<std::string> DataDirectory::ReadName(absl::string_view name) const {
  absl::StatusOr<NameRecord> record = ReadNameFile(Sha256::Hex(name));
  if (!record.ok()) return record.status();
  return std::move(record->id);
}

absl::StatusOr<NameRecord> DataDirectory::ReadNameFile(const std::string& digest) const {
  const std::string path = NamePathOfDigest(digest);
  const absl::StatusOr<std::string> text = ReadSmallFile(path, kMaxRecordBytes);
  if (!text.ok()) return text.status();
  absl::StatusOr<NameRecord> record = DecodeName(*text);
  if (record.ok() && Sha256::Hex(record->name) != digest) record = absl::DataLossError("holds another name");
  if (!record.ok()) {
    return absl::Status(record.status().code(), absl::StrCat("name file ", path, ": ", record.status().message()));
  }
  return record;
}

absl::StatusOr<Config> DataDirectory::ReadConfig(absl::string_view id) const {
  const std::string path = ConfigPath(id);
  const absl::StatusOr<std::string> text = ReadSmallFile(path, kMaxRecordBytes);
  if (!text.ok()) return text.status();
  absl::StatusOr<Config> config = DecodeConfig(*text);
  if (!config.ok()) {
    return absl::Status(config.status().code(), absl::StrCat("config file ", path, ": ", config.status().message(),
                                                             "; the mesh is built with the default config"));
  }
  return config;
}

bool DataDirectory::IsConfigUnknown(const absl::Status& read) const {
  return MayPass(read) || (!read.ok() && !Exists(path_ + "/configs"));
}

bool DataDirectory::Refuse(const std::string& path, const absl::Status& status) {
  if (refused_.insert(path).second) spdlog::error("refused: {}", status.ToString());
  return MayPass(status);
}

std::string DataDirectory::MeshPath(absl::string_view id) const { return absl::StrCat(path_, "/meshes/", id, ".mesh"); }

std::string DataDirectory::ConfigPath(absl::string_view id) const {
  return absl::StrCat(path_, "/configs/", id, ".config");
}

std::string DataDirectory::NamePath(absl::string_view name) const { return NamePathOfDigest(Sha256::Hex(name)); }

std::string DataDirectory::NamePathOfDigest(absl::string_view digest) const {
  return absl::StrCat(path_, "/names/", digest, ".name");
}

absl::Status DataDirectory::Sync() const {
  for (const absl::string_view folder : kFolders) {
    if (absl::Status status = SyncFolder(absl::StrCat(path_, "/", folder)); !status.ok()) return status;
  }
  return absl::OkStatus();
}

absl::StatusOr<TemporaryFile> DataDirectory::Prepare(absl::string_view content) const {
  absl::StatusOr<TemporaryFile> file = TemporaryFile::Create(TemporariesPath());
  if (!file.ok()) return file.status();
  if (absl::Status status = file->Append(content); !status.ok()) return status;
  if (absl::Status status = file->Sync(); !status.ok()) return status;
  return file;
}

}  // namespace deltaray
