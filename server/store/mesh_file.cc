#include "server/store/mesh_file.h"

#include <algorithm>
#include <bit>
#include <chrono>
#include <concepts>
#include <cstring>
#include <memory>
#include <new>
#include <span>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "server/mesh/canonical.h"
#include "server/store/sha256.h"

namespace deltaray {
namespace {

constexpr absl::string_view kMagic = "DRMESH\r\n";
constexpr uint32_t kMeshVersion = 1;
// magic, version, metadata bytes, payload bytes, SHA-256 of the payload.
constexpr size_t kCheckedHeaderBytes = 8 + 4 + 4 + 8 + Sha256::kBytes;
// The same and the SHA-256 of it and the metadata.
constexpr size_t kHeaderBytes = kCheckedHeaderBytes + Sha256::kBytes;
// Pieces small enough to notice a cancelled build in time.
constexpr size_t kReadBytes = size_t{4} << 20;

static_assert(std::endian::native == std::endian::little, "numbers are copied to and from little-endian files");

// A number as its bytes in the file.
class FieldWriter {
 public:
  template <typename T>
  requires std::integral<T> || std::floating_point<T>
  void Add(T value) { bytes_.append(reinterpret_cast<const char*>(&value), sizeof(value)); }
  template <typename T>
  void Add(const Vec3<T>& v) {
    Add(v.x), Add(v.y), Add(v.z);
  }
  void Add(const std::vector<std::string>& strings) {
    Add(static_cast<uint32_t>(strings.size()));
    for (const std::string& s : strings) {
      Add(static_cast<uint32_t>(s.size()));
      bytes_ += s;
    }
  }
  const std::string& bytes() const { return bytes_; }

 private:
  std::string bytes_;
};

// Takes fields off the front. Once something is missing, ok() is false and all that is taken is zero or empty.
class FieldReader {
 public:
  explicit FieldReader(absl::string_view bytes) : rest_(bytes) {}

  template <typename T>
  requires std::integral<T> || std::floating_point<T>
  void Take(T* value) {
    const absl::string_view bytes = TakeBytes(sizeof(T));
    *value = 0;
    if (ok_) std::memcpy(value, bytes.data(), sizeof(T));
  }
  template <typename T>
  void Take(Vec3<T>* v) {
    Take(&v->x), Take(&v->y), Take(&v->z);
  }
  // Null: they are passed over.
  void Take(std::vector<std::string>* strings) {
    uint32_t count = 0;
    Take(&count);
    for (uint32_t i = 0; i < count && ok_; ++i) {
      uint32_t bytes = 0;
      Take(&bytes);
      const absl::string_view string = TakeBytes(bytes);
      if (strings != nullptr) strings->emplace_back(string);
    }
  }
  absl::string_view TakeBytes(size_t count) {
    ok_ = ok_ && count <= rest_.size();
    if (!ok_) return {};
    const absl::string_view bytes = rest_.substr(0, count);
    rest_.remove_prefix(count);
    return bytes;
  }
  bool ok() const { return ok_; }
  bool AtEnd() const { return ok_ && rest_.empty(); }

 private:
  absl::string_view rest_;
  bool ok_ = true;
};

std::string EncodeMetadata(const MeshInfo& info) {
  FieldWriter writer;
  writer.Add(int64_t{std::chrono::duration_cast<std::chrono::microseconds>(info.created.time_since_epoch()).count()});
  writer.Add(info.vertex_count);
  writer.Add(info.triangle_count);
  writer.Add(info.face_count);
  writer.Add(info.report.degenerate_triangles);
  writer.Add(info.report.max_rounding);
  writer.Add(info.origin);
  writer.Add(info.report.bounds.min);
  writer.Add(info.report.bounds.max);
  writer.Add(info.report.warnings);
  writer.Add(info.groups);
  return writer.bytes();
}

bool DecodeMetadata(absl::string_view bytes, bool with_groups, MeshInfo* info) {
  FieldReader reader(bytes);
  int64_t created = 0;
  reader.Take(&created);
  info->created = std::chrono::system_clock::time_point(std::chrono::microseconds(created));
  reader.Take(&info->vertex_count);
  reader.Take(&info->triangle_count);
  reader.Take(&info->face_count);
  reader.Take(&info->report.degenerate_triangles);
  reader.Take(&info->report.max_rounding);
  reader.Take(&info->origin);
  reader.Take(&info->report.bounds.min);
  reader.Take(&info->report.bounds.max);
  reader.Take(&info->report.warnings);
  reader.Take(with_groups ? &info->groups : nullptr);
  return reader.AtEnd();
}

absl::Status Damaged(const std::string& path, absl::string_view what) {
  return absl::DataLossError(absl::StrCat("mesh file ", path, " ", what));
}

// A mesh file as far as its header and metadata tell.
struct MeshFileHead {
  MeshInfo info;
  uint64_t payload_offset = 0;
  uint64_t payload_bytes = 0;
};

absl::StatusOr<MeshFileHead> ReadHead(const FileDescriptor& file, const std::string& path, bool with_groups = false) {
  const absl::StatusOr<uint64_t> size = FileSize(file, path);
  if (!size.ok()) return size.status();

  // The version comes before all else, so that later versions are free to change what follows it.
  std::string header(kHeaderBytes, '\0');
  if (*size < kHeaderBytes) return Damaged(path, "is truncated: it is shorter than its header");
  if (absl::Status status = ReadAt(file, 0, header, path); !status.ok()) return status;
  FieldReader reader(header);
  uint32_t version = 0, metadata_bytes = 0;
  uint64_t payload_bytes = 0;
  if (reader.TakeBytes(kMagic.size()) != kMagic) return Damaged(path, "does not begin as a mesh file does");
  reader.Take(&version);
  if (version > kMeshVersion) {
    return absl::FailedPreconditionError(absl::StrCat("mesh file ", path, " is of format version ", version,
                                                      ", which a newer deltaray wrote; this one reads version ",
                                                      kMeshVersion));
  }
  if (version != kMeshVersion) return Damaged(path, "has no valid format version");
  reader.Take(&metadata_bytes);
  reader.Take(&payload_bytes);
  const absl::string_view payload_sha256 = reader.TakeBytes(Sha256::kBytes);
  const absl::string_view head_sha256 = reader.TakeBytes(Sha256::kBytes);

  // Lengths are compared with the file's before they are believed.
  const uint64_t after_header = *size - kHeaderBytes;
  if (metadata_bytes > after_header || payload_bytes > after_header - metadata_bytes) {
    return Damaged(path, "is truncated, or its header is damaged");
  }
  if (payload_bytes != after_header - metadata_bytes) {
    return Damaged(path, "has trailing bytes, or its header is damaged");
  }

  std::string metadata(metadata_bytes, '\0');
  if (absl::Status status = ReadAt(file, kHeaderBytes, metadata, path); !status.ok()) return status;
  Sha256 sha256;
  sha256.Update(absl::string_view(header).substr(0, kCheckedHeaderBytes));
  sha256.Update(metadata);
  if (sha256.Finish() != head_sha256) return Damaged(path, "has a wrong checksum of header and metadata");

  MeshFileHead head;
  if (!DecodeMetadata(metadata, with_groups, &head.info)) return Damaged(path, "has malformed metadata");
  head.info.id = absl::BytesToHexString(payload_sha256);
  head.info.stored_bytes = *size;
  head.payload_offset = kHeaderBytes + metadata_bytes;
  head.payload_bytes = payload_bytes;
  return head;
}

struct MeshFile {
  std::string path, id;
  FileDescriptor file;
  MeshFileHead head;
};

absl::StatusOr<MeshFile> OpenMeshFile(const std::string& path, const std::string& id, bool with_groups = false) {
  absl::StatusOr<FileDescriptor> file = OpenToRead(path);
  if (!file.ok()) return file.status();
  absl::StatusOr<MeshFileHead> head = ReadHead(*file, path, with_groups);
  if (!head.ok()) return head.status();
  if (head->info.id != id) return Damaged(path, "holds a mesh of another id");
  return MeshFile{path, id, *std::move(file), *std::move(head)};
}

// Reads the geometry piece by piece to where room(offset, bytes) says, and checks it.
absl::Status ReadPayload(const MeshFile& file, const std::function<bool()>& cancelled,
                         const std::function<std::span<char>(uint64_t offset, size_t bytes)>& room) {
  Sha256 sha256;
  for (uint64_t offset = 0; offset < file.head.payload_bytes;) {
    if (cancelled()) return absl::CancelledError("cancelled while the mesh was read");
    const size_t bytes = std::min<uint64_t>(kReadBytes, file.head.payload_bytes - offset);
    const std::span<char> piece = room(offset, bytes);
    if (absl::Status status = ReadAt(file.file, file.head.payload_offset + offset, piece, file.path); !status.ok()) {
      return status;
    }
    sha256.Update({piece.data(), piece.size()});
    offset += bytes;
  }
  if (absl::BytesToHexString(sha256.Finish()) == file.id) return absl::OkStatus();
  return Damaged(file.path, "has a wrong checksum of its geometry");
}

}  // namespace

absl::StatusOr<MeshDigest> DigestMesh(const TriangleMesh& mesh) {
  MeshDigest digest;
  Sha256 sha256;
  const absl::Status status = WriteCanonical(mesh, [&](absl::string_view bytes) {
    sha256.Update(bytes);
    digest.bytes += bytes.size();
    return absl::OkStatus();
  });
  if (!status.ok()) return status;
  digest.sha256 = sha256.Finish();
  return digest;
}

uint64_t MeshFileBytes(const MeshDigest& digest, const MeshInfo& info) {
  return kHeaderBytes + EncodeMetadata(info).size() + digest.bytes;
}

absl::Status WriteMeshFile(const TriangleMesh& mesh, const MeshDigest& digest, const MeshInfo& info,
                           TemporaryFile* file) {
  const std::string metadata = EncodeMetadata(info);
  FieldWriter header;
  header.Add(static_cast<uint32_t>(kMeshVersion));
  header.Add(static_cast<uint32_t>(metadata.size()));
  header.Add(digest.bytes);
  const std::string checked_header = absl::StrCat(kMagic, header.bytes(), digest.sha256);
  Sha256 sha256;
  sha256.Update(checked_header);
  sha256.Update(metadata);

  if (absl::Status status = file->Append(absl::StrCat(checked_header, sha256.Finish(), metadata)); !status.ok()) {
    return status;
  }
  return WriteCanonical(mesh, [&](absl::string_view bytes) { return file->Append(bytes); });
}

absl::StatusOr<MeshInfo> ReadMeshFileInfo(const std::string& path) {
  const absl::StatusOr<FileDescriptor> file = OpenToRead(path);
  if (!file.ok()) return file.status();
  absl::StatusOr<MeshFileHead> head = ReadHead(*file, path);
  if (!head.ok()) return head.status();
  return std::move(head->info);
}

absl::StatusOr<std::vector<std::string>> ReadMeshFileGroups(const std::string& path, const std::string& id) {
  absl::StatusOr<MeshFile> file = OpenMeshFile(path, id, /*with_groups=*/true);
  if (!file.ok()) return file.status();
  return std::move(file->head.info.groups);
}

absl::StatusOr<TriangleMesh> ReadMeshFile(const std::string& path, const std::string& id,
                                          const std::function<bool()>& cancelled) {
  absl::StatusOr<MeshFile> file = OpenMeshFile(path, id);
  if (!file.ok()) return file.status();

  // Read, not mapped: a mapped file that somebody cuts short would kill the server.
  const std::unique_ptr<char[]> buffer(new (std::nothrow) char[file->head.payload_bytes]);
  if (!buffer) return absl::ResourceExhaustedError(absl::StrCat("no memory to read mesh file ", path));
  const std::span<char> payload(buffer.get(), file->head.payload_bytes);
  absl::Status read =
      ReadPayload(*file, cancelled, [&](uint64_t offset, size_t bytes) { return payload.subspan(offset, bytes); });
  if (!read.ok()) return read;

  absl::StatusOr<TriangleMesh> mesh = ReadCanonical(payload);
  if (!mesh.ok()) return Damaged(path, absl::StrCat("holds no valid mesh: ", mesh.status().message()));
  if (mesh->positions.size() != file->head.info.vertex_count ||
      mesh->indices.size() != file->head.info.triangle_count) {
    return Damaged(path, "has metadata that does not fit its geometry");
  }
  return mesh;
}

absl::Status CheckMeshFile(const std::string& path, const std::string& id, const std::function<bool()>& cancelled) {
  const absl::StatusOr<MeshFile> file = OpenMeshFile(path, id);
  if (!file.ok()) return file.status();
  std::vector<char> buffer(std::min<uint64_t>(kReadBytes, file->head.payload_bytes));
  return ReadPayload(*file, cancelled, [&](uint64_t, size_t bytes) { return std::span(buffer).first(bytes); });
}

}  // namespace deltaray
