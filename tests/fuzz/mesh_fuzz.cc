// The entry point of libFuzzer for one format of mesh files, DELTARAY_FUZZ_FORMAT: whatever the bytes, a valid mesh or
// a refusal that says why.

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "absl/strings/str_cat.h"
#include "server/geometry/triangle_test.h"
#include "server/mesh/canonical.h"
#include "server/mesh/read_mesh.h"
#include "tests/fuzz/byte_reader.h"
#include "tests/fuzz/check.h"

namespace deltaray {
namespace {

// Small, so that limits are reached by small files.
constexpr MeshLimits kLimits{.max_triangles = 5000,
                             .max_vertices = 5000,
                             .max_face_corners = 500,
                             .max_line_bytes = 1000,
                             .max_groups = 20,
                             .max_group_name_bytes = 64,
                             .max_group_bytes = 400};

void CheckMesh(const ReadMeshResult& read) {
  const TriangleMesh& mesh = read.mesh;
  Check(mesh.positions.size() <= kLimits.max_vertices && mesh.indices.size() <= kLimits.max_triangles &&
            mesh.groups.size() <= kLimits.max_groups,
        "a limit passed over");
  Bounds bounds;
  for (const Vec3f& position : mesh.positions) {
    Check(IsFinite(position) && IsFinite(static_cast<Vec3d>(position) + mesh.origin), "a coordinate is not finite");
    bounds.Extend(position);
  }
  Check(bounds.min == read.report.bounds.min && bounds.max == read.report.bounds.max, "the bounds");
  Check(mesh.face_ids.empty() || mesh.face_ids.size() == mesh.indices.size(), "the length of face_ids");
  Check(mesh.group_ids.empty() || mesh.group_ids.size() == mesh.indices.size(), "the length of group_ids");
  uint64_t degenerate = 0;
  for (uint32_t i = 0; i < mesh.indices.size(); ++i) {
    for (const uint32_t index : mesh.indices[i]) Check(index < mesh.positions.size(), "an index");
    Check(mesh.FaceId(i) < mesh.face_count, "a face id");
    Check(mesh.GroupId(i) == kNoGroup || mesh.GroupId(i) < mesh.groups.size(), "a group id");
    if (IsDegenerate(mesh.triangles()[i])) ++degenerate;
  }
  Check(degenerate == read.report.degenerate_triangles, "the count of degenerate triangles");
  for (const std::string& group : mesh.groups) Check(ToValidUtf8(group) == group, "a group's name");
  Check(read.report.warnings.size() <= 100, "too many warnings");
  for (const std::string& warning : read.report.warnings) Check(ToValidUtf8(warning) == warning, "a warning's text");

  std::string canonical;
  const absl::Status written = WriteCanonical(mesh, [&canonical](absl::string_view bytes) {
    absl::StrAppend(&canonical, bytes);
    return absl::OkStatus();
  });
  Check(written.ok(), "WriteCanonical");
  const absl::StatusOr<TriangleMesh> again = ReadCanonical(canonical);
  Check(again.ok() && MeshId(*again) == MeshId(mesh), "canonical bytes are not read as they were written");
}

}  // namespace
}  // namespace deltaray

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace deltaray;
  ReadMeshOptions options;
  options.format = MeshFormat::DELTARAY_FUZZ_FORMAT;
  options.limits = kLimits;
  std::span<const uint8_t> bytes(data, size);
  if (options.format == MeshFormat::kRaw) {
    // What the request says of the arrays, which may be a lie.
    constexpr size_t kLayoutBytes = 9;
    ByteReader layout(bytes);
    options.raw.float64 = layout.Byte() % 2 == 1;
    options.raw.vertex_count = layout.Word();
    options.raw.triangle_count = layout.Word();
    bytes = bytes.subspan(size < kLayoutBytes ? size : kLayoutBytes);
  }
  const std::span<const char> file(reinterpret_cast<const char*>(bytes.data()), bytes.size());

  const absl::StatusOr<ReadMeshResult> read = ReadMesh(file, options);
  if (read.ok()) {
    CheckMesh(*read);
  } else {
    CheckRefusal(read.status(), {absl::StatusCode::kInvalidArgument, absl::StatusCode::kResourceExhausted});
  }
  // Cancelled at some point: the same, or CANCELLED.
  uint32_t polls = size % 7;
  options.cancelled = [&polls] { return polls-- == 0; };
  const absl::StatusOr<ReadMeshResult> cancelled = ReadMesh(file, options);
  Check(absl::IsCancelled(cancelled.status()) || cancelled.status() == read.status(), "a cancelled read");
  return 0;
}
