#include "server/mesh/read_mesh.h"

#include <new>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "server/mesh/face_collector.h"
#include "server/mesh/line_cursor.h"
#include "server/mesh/obj_reader.h"
#include "server/mesh/ply_reader.h"
#include "server/mesh/raw_reader.h"
#include "server/mesh/stl_reader.h"

namespace deltaray {
namespace {

absl::StatusOr<MeshFormat> Detect(absl::string_view bytes, const MeshLimits& limits) {
  if (bytes.empty()) return Malformed(Location::Byte(0), "the file is empty");
  if (LooksLikePly(bytes)) return MeshFormat::kPly;
  if (HasBinaryStlSize(bytes)) return MeshFormat::kStl;
  if (absl::StartsWith(bytes, "\xFF\xFE") || absl::StartsWith(bytes, "\xFE\xFF")) {
    return Malformed(Location::Byte(0), "the file is text in UTF-16; only UTF-8 is read");
  }
  // Text tells its format by its first line that is neither blank nor a comment.
  LineCursor lines(bytes, limits.max_line_bytes);
  absl::string_view line;
  while (true) {
    const absl::StatusOr<bool> more = lines.Next(&line);
    if (!more.ok()) return more.status();
    if (!*more)
      return Malformed(lines.where(), "the format cannot be told: the file has nothing but blank lines and comments");
    line = absl::StripAsciiWhitespace(line);
    if (line.empty() || line.front() == '#') continue;
    if (IsObjStatement(line)) return MeshFormat::kObj;
    if (BeginsAsciiStl(line)) return MeshFormat::kStl;
    // Text has no zero bytes, and a binary STL file that was cut off is not told by its size any more.
    const uint64_t stl_size = absl::StrContains(bytes, absl::string_view("\0", 1)) ? BinaryStlSize(bytes) : 0;
    return Malformed(
        lines.where(), "the format cannot be told: no OBJ, PLY or STL file begins with ", Quoted(line),
        stl_size == 0 ? ""
                      : absl::StrCat("; as a binary STL file it would have ", stl_size, " bytes, not ", bytes.size()));
  }
}

const char* FormatName(MeshFormat format) {
  return format == MeshFormat::kObj ? "OBJ" : format == MeshFormat::kPly ? "PLY" : "STL";
}

// The error of reading the bytes in the format that was asked for, which names the one that they look like.
absl::Status WithFormatHint(const absl::Status& status, absl::string_view bytes, const ReadMeshOptions& options) {
  const absl::StatusOr<MeshFormat> looks = Detect(bytes, options.limits);
  if (options.format == MeshFormat::kDetect || !looks.ok() || *looks == options.format) return status;
  return absl::Status(status.code(), absl::StrCat(status.message(), "; it was read as ", FormatName(options.format),
                                                  ", but looks like ", FormatName(*looks)));
}

absl::StatusOr<ReadMeshResult> Read(absl::string_view bytes, const ReadMeshOptions& options) {
  absl::StatusOr<MeshFormat> format = options.format;
  if (*format == MeshFormat::kDetect) format = Detect(bytes, options.limits);
  if (!format.ok()) return format.status();
  if (*format == MeshFormat::kRaw) return ReadRaw(bytes, options);

  FaceCollector collector(options, /*first_index=*/*format == MeshFormat::kObj ? 1 : 0);
  absl::Status status;
  if (*format == MeshFormat::kObj) status = ReadObj(bytes, &collector);
  if (*format == MeshFormat::kPly) status = ReadPly(bytes, &collector);
  if (*format == MeshFormat::kStl) status = ReadStl(bytes, &collector);
  if (!status.ok()) return WithFormatHint(status, bytes, options);
  absl::StatusOr<ReadMeshResult> result = collector.Finish();
  if (result.ok()) result->format = *format;
  return result;
}

}  // namespace

absl::StatusOr<ReadMeshResult> ReadMesh(std::span<const char> bytes, const ReadMeshOptions& options) {
  try {
    return Read({bytes.data(), bytes.size()}, options);
  } catch (const std::bad_alloc&) {
    return absl::ResourceExhaustedError("the memory does not suffice to read the mesh");
  }
}

}  // namespace deltaray
