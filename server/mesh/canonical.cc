#include "server/mesh/canonical.h"

#include <openssl/evp.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <memory>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "server/mesh/utf8.h"

namespace deltaray {
namespace {

static_assert(std::endian::native == std::endian::little, "the layout is copied from memory");
static_assert(sizeof(Vec3f) == 12 && sizeof(std::array<uint32_t, 3>) == 12);

constexpr std::array<char, 8> kMagic = {'d', 'e', 'l', 't', 'a', 'r', 'a', 'y'};
constexpr uint32_t kVersion = 1;
constexpr uint32_t kHasFaceIds = 1, kHasGroupIds = 2;

struct Header {
  std::array<char, 8> magic;
  uint32_t version;
  uint32_t flags;
  uint64_t vertices, triangles, faces, groups;
  Vec3d origin;
};
static_assert(sizeof(Header) == 72);

// Ids that say the same as no ids at all are left out.
uint32_t Flags(const TriangleMesh& mesh) {
  uint32_t flags = 0;
  for (size_t i = 0; i < mesh.face_ids.size(); ++i) {
    if (mesh.face_ids[i] != i) flags |= kHasFaceIds;
  }
  if (std::any_of(mesh.group_ids.begin(), mesh.group_ids.end(), [](uint32_t id) { return id != kNoGroup; })) {
    flags |= kHasGroupIds;
  }
  return flags;
}

template <typename T>
absl::string_view BytesOf(const T* values, size_t count) {
  return {reinterpret_cast<const char*>(values), count * sizeof(T)};
}

absl::Status WritePositions(const std::vector<Vec3f>& positions,
                            const std::function<absl::Status(absl::string_view)>& sink) {
  std::vector<Vec3f> chunk;
  constexpr size_t kChunk = 8192;
  for (size_t begin = 0; begin < positions.size(); begin += kChunk) {
    chunk.clear();
    // Adding zero turns -0 into +0: the two are the same place.
    for (size_t i = begin; i < std::min(begin + kChunk, positions.size()); ++i) {
      chunk.push_back(positions[i] + Vec3f{0, 0, 0});
    }
    if (absl::Status status = sink(BytesOf(chunk.data(), chunk.size())); !status.ok()) return status;
  }
  return absl::OkStatus();
}

absl::Status Damaged(const absl::AlphaNum& what) { return absl::DataLossError(absl::StrCat("canonical mesh: ", what)); }

// Takes arrays off the front of the bytes.
class Input {
 public:
  explicit Input(std::span<const char> bytes) : bytes_(bytes) {}

  template <typename T>
  bool Take(size_t count, T* values) {
    if (count > bytes_.size() / sizeof(T)) return false;
    if (count > 0) std::memcpy(values, bytes_.data(), count * sizeof(T));
    bytes_ = bytes_.subspan(count * sizeof(T));
    return true;
  }
  template <typename T>
  bool Take(size_t count, std::vector<T>* values) {
    if (count > bytes_.size() / sizeof(T)) return false;
    values->resize(count);
    return Take(count, values->data());
  }
  size_t remaining() const { return bytes_.size(); }

 private:
  std::span<const char> bytes_;
};

absl::Status ReadGroups(uint64_t count, Input* input, std::vector<std::string>* groups) {
  for (uint64_t i = 0; i < count; ++i) {
    uint32_t length;
    if (!input->Take(1, &length) || length > input->remaining())
      return Damaged(absl::StrCat("group ", i, " is cut off"));
    std::string name(length, '\0');
    input->Take(length, name.data());
    if (ToValidUtf8(name) != name) return Damaged(absl::StrCat("the name of group ", i, " is not printable UTF-8"));
    groups->push_back(std::move(name));
  }
  return absl::OkStatus();
}

absl::Status CheckInvariants(const TriangleMesh& mesh) {
  if (!IsFinite(mesh.origin)) return Damaged("origin is not finite");
  for (size_t i = 0; i < mesh.positions.size(); ++i) {
    if (!IsFinite(mesh.positions[i]) || !IsFinite(static_cast<Vec3d>(mesh.positions[i]) + mesh.origin)) {
      return Damaged(absl::StrCat("vertex ", i, " is not finite"));
    }
  }
  for (size_t i = 0; i < mesh.indices.size(); ++i) {
    for (const uint32_t index : mesh.indices[i]) {
      if (index >= mesh.positions.size()) return Damaged(absl::StrCat("triangle ", i, " has index ", index));
    }
    if (mesh.FaceId(i) >= mesh.face_count) return Damaged(absl::StrCat("triangle ", i, " has face ", mesh.FaceId(i)));
    if (mesh.GroupId(i) != kNoGroup && mesh.GroupId(i) >= mesh.groups.size()) {
      return Damaged(absl::StrCat("triangle ", i, " has group ", mesh.GroupId(i)));
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status WriteCanonical(const TriangleMesh& mesh, const std::function<absl::Status(absl::string_view)>& sink) {
  const Header header = {.magic = kMagic,
                         .version = kVersion,
                         .flags = Flags(mesh),
                         .vertices = mesh.positions.size(),
                         .triangles = mesh.indices.size(),
                         .faces = mesh.face_count,
                         .groups = mesh.groups.size(),
                         .origin = mesh.origin + Vec3d{0, 0, 0}};
  absl::Status status = sink(BytesOf(&header, 1));
  if (status.ok()) status = WritePositions(mesh.positions, sink);
  if (status.ok()) status = sink(BytesOf(mesh.indices.data(), mesh.indices.size()));
  if (status.ok() && header.flags & kHasFaceIds) status = sink(BytesOf(mesh.face_ids.data(), mesh.face_ids.size()));
  if (status.ok() && header.flags & kHasGroupIds) status = sink(BytesOf(mesh.group_ids.data(), mesh.group_ids.size()));
  for (size_t i = 0; i < mesh.groups.size() && status.ok(); ++i) {
    const uint32_t length = mesh.groups[i].size();
    status = sink(BytesOf(&length, 1));
    if (status.ok()) status = sink(mesh.groups[i]);
  }
  return status;
}

absl::StatusOr<TriangleMesh> ReadCanonical(std::span<const char> bytes) {
  Input input(bytes);
  Header header;
  if (!input.Take(1, &header)) return Damaged("cut off in the header");
  if (header.magic != kMagic) return Damaged("does not start with \"deltaray\"");
  if (header.version != kVersion) return Damaged(absl::StrCat("version ", header.version, " is unknown"));
  if (header.flags & ~(kHasFaceIds | kHasGroupIds))
    return Damaged(absl::StrCat("flags ", header.flags, " are unknown"));
  if (std::max({header.vertices, header.triangles, header.faces}) > kMaxMeshCount)
    return Damaged("a count is past 2^31");

  TriangleMesh mesh;
  mesh.origin = header.origin;
  mesh.face_count = header.faces;
  if (!input.Take(header.vertices, &mesh.positions)) return Damaged("cut off in the positions");
  if (!input.Take(header.triangles, &mesh.indices)) return Damaged("cut off in the indices");
  if (header.flags & kHasFaceIds && !input.Take(header.triangles, &mesh.face_ids)) {
    return Damaged("cut off in the face ids");
  }
  if (header.flags & kHasGroupIds && !input.Take(header.triangles, &mesh.group_ids)) {
    return Damaged("cut off in the group ids");
  }
  if (absl::Status status = ReadGroups(header.groups, &input, &mesh.groups); !status.ok()) return status;
  if (input.remaining() > 0) return Damaged(absl::StrCat(input.remaining(), " bytes too many"));
  if (absl::Status status = CheckInvariants(mesh); !status.ok()) return status;
  return mesh;
}

std::string MeshId(const TriangleMesh& mesh) {
  const std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context(EVP_MD_CTX_new(), &EVP_MD_CTX_free);
  EVP_DigestInit_ex(context.get(), EVP_sha256(), nullptr);
  WriteCanonical(mesh, [&](absl::string_view bytes) {
    EVP_DigestUpdate(context.get(), bytes.data(), bytes.size());
    return absl::OkStatus();
  }).IgnoreError();
  unsigned char digest[EVP_MAX_MD_SIZE];
  unsigned int size = 0;
  EVP_DigestFinal_ex(context.get(), digest, &size);
  return absl::BytesToHexString({reinterpret_cast<const char*>(digest), size});
}

}  // namespace deltaray
