#include "server/mesh/raw_reader.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/mesh/finish_mesh.h"
#include "server/mesh/location.h"
#include "server/mesh/origin.h"

namespace deltaray {
namespace {

static_assert(std::endian::native == std::endian::little, "the arrays are copied as they are");

absl::Status CheckLayout(const RawLayout& raw, const MeshLimits& limits, size_t size) {
  // By the fields of an upload's header: the file is not to blame.
  if (raw.vertex_count > std::min(limits.max_vertices, kMaxMeshCount)) {
    return OverLimit("header.raw_layout.vertex_count", absl::StrCat(raw.vertex_count, " vertices"), "--max-vertices",
                     limits.max_vertices);
  }
  if (raw.triangle_count > std::min(limits.max_triangles, kMaxMeshCount)) {
    return OverLimit("header.raw_layout.triangle_count", absl::StrCat(raw.triangle_count, " triangles"),
                     "--max-triangles", limits.max_triangles);
  }
  const uint64_t expected = raw.vertex_count * (raw.float64 ? 24 : 12) + raw.triangle_count * 12;
  if (size != expected) {
    return Malformed(Location::Byte(std::min<uint64_t>(size, expected)), raw.vertex_count, " vertices in ",
                     raw.float64 ? "float64" : "float32", " and ", raw.triangle_count, " triangles take ", expected,
                     " bytes, but there are ", size);
  }
  return absl::OkStatus();
}

// Copies `count` values of T off the front of `bytes`.
template <typename T>
std::vector<T> Take(std::span<const char>* bytes, uint64_t count) {
  std::vector<T> values(count);
  if (count > 0) std::memcpy(values.data(), bytes->data(), count * sizeof(T));
  *bytes = bytes->subspan(count * sizeof(T));
  return values;
}

template <typename T>
absl::Status CheckPositions(const std::vector<Vec3<T>>& positions) {
  for (size_t i = 0; i < positions.size(); ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      if (std::isfinite(static_cast<float>(positions[i][axis]))) continue;
      return Malformed(Location::Byte((3 * i + axis) * sizeof(T)), "vertex ", i, ": ",
                       absl::string_view("xyz").substr(axis, 1), " = ", positions[i][axis],
                       " is not a number in the range of float32");
    }
  }
  return absl::OkStatus();
}

// `bytes` are the indices, which begin at byte `begin` of the file.
absl::Status CheckIndices(std::span<const char> bytes, uint64_t begin, uint64_t vertex_count) {
  for (size_t i = 0; i < bytes.size() / 4; ++i) {
    uint32_t index;
    std::memcpy(&index, bytes.data() + 4 * i, 4);
    if (index < vertex_count) continue;
    return Malformed(Location::Byte(begin + 4 * i), "triangle ", i / 3, " names vertex ", index, ", but there are ",
                     vertex_count, " vertices, counted from 0");
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<ReadMeshResult> ReadRaw(std::span<const char> bytes, const ReadMeshOptions& options) {
  const RawLayout& raw = options.raw;
  if (absl::Status status = CheckLayout(raw, options.limits, bytes.size()); !status.ok()) return status;
  const uint64_t position_bytes = raw.vertex_count * (raw.float64 ? 24 : 12);
  const std::span<const char> indices = bytes.subspan(position_bytes);
  if (absl::Status status = CheckIndices(indices, position_bytes, raw.vertex_count); !status.ok()) return status;

  if (options.take_memory) {
    // The arrays of the file, and where they are float64 those of the mesh beside them.
    const uint64_t memory = bytes.size() + (raw.float64 ? 12 * (raw.vertex_count + raw.triangle_count) : 0);
    if (absl::Status status = options.take_memory(memory); !status.ok()) return status;
  }
  absl::StatusOr<ReadMeshResult> result;
  if (raw.float64) {
    PolygonMesh mesh;
    mesh.vertices = Take<Vec3d>(&bytes, raw.vertex_count);
    if (absl::Status status = CheckPositions(mesh.vertices); !status.ok()) return status;
    mesh.corners = Take<uint32_t>(&bytes, 3 * raw.triangle_count);
    mesh.face_count = raw.triangle_count;
    result = FinishMesh(std::move(mesh), Warnings(), options.cancelled);
  } else {
    TriangleMesh mesh;
    mesh.positions = Take<Vec3f>(&bytes, raw.vertex_count);
    if (absl::Status status = CheckPositions(mesh.positions); !status.ok()) return status;
    mesh.indices = Take<std::array<uint32_t, 3>>(&bytes, raw.triangle_count);
    mesh.origin = ChooseOrigin(mesh);
    for (Vec3f& position : mesh.positions) position = StoredPosition(static_cast<Vec3d>(position), mesh.origin);
    mesh.face_count = raw.triangle_count;
    result = FinishMesh(std::move(mesh), /*max_rounding=*/0, Warnings(), options.cancelled);
  }
  if (result.ok()) result->format = MeshFormat::kRaw;
  return result;
}

}  // namespace deltaray
