#include "server/mesh/read_mesh.h"

#include <exception>
#include <new>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "server/mesh/face_collector.h"
#include "server/mesh/line_cursor.h"
#include "server/mesh/obj_reader.h"
#include "server/mesh/raw_reader.h"

namespace deltaray {
namespace {

absl::StatusOr<ReadMeshResult> Read(absl::string_view text, MeshFormat format, const ReadMeshOptions& options) {
  if (format == MeshFormat::kRaw) return ReadRaw(text, options);
  FaceCollector collector(options, /*first_index=*/1);
  absl::Status status = ReadObj(text, &collector);
  if (!status.ok()) return status;
  return collector.Finish();
}

}  // namespace

absl::StatusOr<ReadMeshResult> ReadMesh(std::span<const char> bytes, const ReadMeshOptions& options) {
  try {
    absl::string_view text(bytes.data(), bytes.size());
    const MeshFormat format = options.format == MeshFormat::kDetect ? MeshFormat::kObj : options.format;
    absl::StatusOr<ReadMeshResult> result = Read(text, format, options);
    if (result.ok()) result->format = format;
    return result;
  } catch (const std::bad_alloc&) {
    return absl::ResourceExhaustedError("the memory does not suffice to read the mesh");
  }
}

}  // namespace deltaray
