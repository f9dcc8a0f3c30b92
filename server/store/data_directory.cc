#include "server/store/data_directory.h"

#include <algorithm>
#include <filesystem>
#include <string_view>
#include <system_error>
#include <utility>

#include "absl/container/flat_hash_set.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
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

void Drop(const std::string& path, std::string_view why) {
  if (absl::Status status = RemoveFile(path); status.ok()) {
    spdlog::info("removed {}: {}", path, why);
  } else {
    spdlog::warn("{}: {}, but {}", path, why, status.ToString());
  }
}

}  // namespace

absl::StatusOr<DataDirectory> DataDirectory::Open(const std::string& path, Contents* contents) {
  if (path.empty()) return absl::InvalidArgumentError("data_directory: is empty");
  for (const absl::string_view folder : kFolders) {
    if (absl::Status status = MakeFolder(absl::StrCat(path, "/", folder)); !status.ok()) return status;
  }
  DataDirectory directory(path);
  if (const size_t removed = RemoveAbandonedFiles(directory.TemporariesPath()); removed > 0) {
    spdlog::info("removed {} temporaries that a dead server left in {}", removed, directory.TemporariesPath());
  }
  if (absl::Status status = directory.Read(contents); !status.ok()) return status;
  return directory;
}

std::string DataDirectory::MeshPath(absl::string_view id) const { return absl::StrCat(path_, "/meshes/", id, ".mesh"); }

std::string DataDirectory::ConfigPath(absl::string_view id) const {
  return absl::StrCat(path_, "/configs/", id, ".config");
}

std::string DataDirectory::NamePath(absl::string_view name) const {
  return absl::StrCat(path_, "/names/", Sha256::Hex(name), ".name");
}

absl::StatusOr<TemporaryFile> DataDirectory::Prepare(absl::string_view content) const {
  absl::StatusOr<TemporaryFile> file = TemporaryFile::Create(TemporariesPath());
  if (!file.ok()) return file.status();
  if (absl::Status status = file->Append(content); !status.ok()) return status;
  if (absl::Status status = file->Sync(); !status.ok()) return status;
  return file;
}

absl::Status DataDirectory::Read(Contents* contents) const {
  size_t refused = 0;
  if (absl::Status status = ReadMeshes(contents, &refused); !status.ok()) return status;
  if (absl::Status status = ReadNames(contents, &refused); !status.ok()) return status;
  if (absl::Status status = RemoveStrayConfigs(); !status.ok()) return status;
  spdlog::info("opened data directory {}: {} meshes, {} names, {} files refused", path_, contents->meshes.size(),
               contents->names.size(), refused);
  return absl::OkStatus();
}

absl::Status DataDirectory::ReadMeshes(Contents* contents, size_t* refused) const {
  const absl::StatusOr<std::vector<std::string>> ids = ListFiles("meshes", ".mesh", refused);
  if (!ids.ok()) return ids.status();
  for (const std::string& id : *ids) {
    absl::StatusOr<MeshInfo> info = ReadMeshFileInfo(MeshPath(id));
    if (absl::IsNotFound(info.status())) continue;  // another server has just deleted it
    if (info.ok() && info->id != id) {
      info = absl::DataLossError(absl::StrCat("mesh file ", MeshPath(id), " holds a mesh of another id"));
    }
    if (!info.ok()) {
      spdlog::error("refused: {}", info.status().ToString());
      ++*refused;
      continue;
    }
    info->config = ReadConfig(id, refused);
    contents->meshes.push_back(*std::move(info));
  }
  return absl::OkStatus();
}

absl::Status DataDirectory::ReadNames(Contents* contents, size_t* refused) const {
  absl::flat_hash_set<absl::string_view> ids;
  for (const MeshInfo& mesh : contents->meshes) ids.insert(mesh.id);

  const absl::StatusOr<std::vector<std::string>> digests = ListFiles("names", ".name", refused);
  if (!digests.ok()) return digests.status();
  for (const std::string& digest : *digests) {
    const std::string path = absl::StrCat(path_, "/names/", digest, ".name");
    const absl::StatusOr<std::string> text = ReadSmallFile(path, kMaxRecordBytes);
    if (absl::IsNotFound(text.status())) continue;
    absl::StatusOr<NameRecord> record = text.ok() ? DecodeName(*text) : text.status();
    if (record.ok() && NamePath(record->name) != path) record = absl::DataLossError("holds another name");
    if (!record.ok()) {
      spdlog::error("refused: name file {}: {}", path, record.status().ToString());
      ++*refused;
    } else if (ids.contains(record->id)) {
      contents->names.push_back(*std::move(record));
    } else if (Exists(MeshPath(record->id))) {
      // The mesh was refused. The name stays for when its file is mended.
      spdlog::warn("left out: name file {}: its mesh was not opened", path);
    } else {
      Drop(path, "a name of a mesh that is not there");
    }
  }
  return absl::OkStatus();
}

absl::Status DataDirectory::RemoveStrayConfigs() const {
  size_t refused = 0;
  const absl::StatusOr<std::vector<std::string>> ids = ListFiles("configs", ".config", &refused);
  if (!ids.ok()) return ids.status();
  for (const std::string& id : *ids) {
    if (!Exists(MeshPath(id))) Drop(ConfigPath(id), "a config of a mesh that is not there");
  }
  return absl::OkStatus();
}

Config DataDirectory::ReadConfig(absl::string_view id, size_t* refused) const {
  const std::string path = ConfigPath(id);
  const absl::StatusOr<std::string> text = ReadSmallFile(path, kMaxRecordBytes);
  if (absl::IsNotFound(text.status())) return Config();
  const absl::StatusOr<Config> config = text.ok() ? DecodeConfig(*text) : text.status();
  if (config.ok()) return *config;
  spdlog::error("refused: config file {}: {}; the mesh is built with the default config", path,
                config.status().ToString());
  ++*refused;
  return Config();
}

absl::StatusOr<std::vector<std::string>> DataDirectory::ListFiles(absl::string_view folder, absl::string_view ending,
                                                                  size_t* refused) const {
  std::vector<std::string> found;
  const std::string path = absl::StrCat(path_, "/", folder);
  std::error_code error;
  for (std::filesystem::directory_iterator entry(path, error), end; !error && entry != end; entry.increment(error)) {
    const std::string file = entry->path().filename().string();
    absl::string_view digest = file;
    if (absl::ConsumeSuffix(&digest, ending) && IsMeshId(digest)) {
      found.emplace_back(digest);
    } else {
      spdlog::warn("refused: {}/{} is no file of deltaray's", path, absl::CHexEscape(file));
      ++*refused;
    }
  }
  if (error) return FileError(error.value(), "list", path);
  std::sort(found.begin(), found.end());
  return found;
}

}  // namespace deltaray
