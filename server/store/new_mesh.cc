#include "server/store/new_mesh.h"

#include <chrono>
#include <span>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "server/store/record_file.h"

namespace deltaray {
namespace {

absl::Status CheckAnnounced(UploadFile& file, const Upload::CommitOptions& options) {
  const absl::StatusOr<std::string> sha256 = file.Finish();
  if (!sha256.ok()) return sha256.status();
  if (options.size && *options.size != file.size()) {
    return absl::InvalidArgumentError(
        absl::StrCat("header.size_bytes: ", *options.size, " bytes were announced, ", file.size(), " arrived"));
  }
  if (!options.sha256.empty() && options.sha256 != *sha256) {
    return absl::InvalidArgumentError(absl::StrCat("header.sha256: ", absl::BytesToHexString(options.sha256),
                                                   " was announced, ", absl::BytesToHexString(*sha256), " arrived"));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<NewMesh> ReadNewMesh(UploadFile file, const Upload::CommitOptions& options, const MeshLimits& limits,
                                    std::shared_ptr<TreeBudget::Reservation> memory) {
  if (!options.name.empty()) {
    if (absl::Status status = ValidateMeshName(options.name); !status.ok()) return status;
  }
  if (options.config) {
    if (absl::Status status = Validate(*options.config); !status.ok()) return status;
  }
  if (absl::Status status = CheckAnnounced(file, options); !status.ok()) return status;

  ReadMeshOptions read_options = options.read;
  read_options.limits = limits;
  read_options.take_memory = [&](uint64_t bytes) { return memory->GrowTo(bytes); };
  absl::StatusOr<ReadMeshResult> read;
  const absl::Status read_status = file.Read([&](std::span<const char> bytes) {
    read = ReadMesh(bytes, read_options);
    return read.status();
  });
  if (!read_status.ok()) return read_status;

  NewMesh upload;
  upload.loaded.mesh = std::make_shared<const TriangleMesh>(std::move(read->mesh));
  memory->ShrinkTo(upload.loaded.mesh->Bytes());
  upload.loaded.memory = std::move(memory);
  upload.name = options.name;
  upload.config = options.config;
  const TriangleMesh& mesh = *upload.loaded.mesh;
  absl::StatusOr<MeshDigest> digest = DigestMesh(mesh);
  if (!digest.ok()) return digest.status();
  upload.digest = *std::move(digest);

  upload.info.id = absl::BytesToHexString(upload.digest.sha256);
  upload.info.vertex_count = mesh.positions.size();
  upload.info.triangle_count = mesh.indices.size();
  upload.info.face_count = mesh.face_count;
  upload.info.origin = mesh.origin;
  upload.info.groups = mesh.groups;
  upload.info.report = std::move(read->report);
  // As the file keeps it, so that it is the same after a restart.
  upload.info.created = std::chrono::floor<std::chrono::microseconds>(std::chrono::system_clock::now());
  upload.info.stored_bytes = MeshFileBytes(upload.digest, upload.info);
  upload.cancelled = options.read.cancelled;
  return upload;
}

absl::Status PreparedFiles::PrepareLabels(const NewMesh& upload, const DataDirectory& directory) {
  if (upload.config) {
    absl::StatusOr<TemporaryFile> file = directory.Prepare(EncodeConfig(*upload.config));
    if (!file.ok()) return file.status();
    config.emplace(*std::move(file));
  }
  if (!upload.name.empty()) {
    absl::StatusOr<TemporaryFile> file = directory.Prepare(EncodeName({upload.name, upload.info.id}));
    if (!file.ok()) return file.status();
    name.emplace(*std::move(file));
  }
  return absl::OkStatus();
}

absl::Status PreparedFiles::PrepareMesh(const NewMesh& upload, const DataDirectory& directory) {
  if (absl::Status status = charge.Add(upload.info.stored_bytes); !status.ok()) return status;
  absl::StatusOr<TemporaryFile> file = TemporaryFile::Create(directory.TemporariesPath());
  if (!file.ok()) return file.status();
  if (absl::Status status = WriteMeshFile(*upload.loaded.mesh, upload.digest, upload.info, &*file); !status.ok()) {
    return status;
  }
  if (absl::Status status = file->Sync(); !status.ok()) return status;
  mesh.emplace(*std::move(file));
  return absl::OkStatus();
}

}  // namespace deltaray
