#include "server/mesh/stl_reader.h"

#include <algorithm>
#include <array>
#include <cstring>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "server/mesh/line_cursor.h"
#include "server/mesh/number.h"
#include "server/mesh/vertex_merger.h"

namespace deltaray {
namespace {

constexpr size_t kHeaderBytes = 84;    // 80 bytes of anything, and the number of triangles
constexpr size_t kTriangleBytes = 50;  // the normal, three corners, and two bytes of attributes

absl::Status ReadBinary(absl::string_view bytes, FaceCollector* collector) {
  if (bytes.size() < kHeaderBytes) {
    return Malformed(Location::Byte(bytes.size()), "a binary STL file has ", kHeaderBytes, " bytes or more");
  }
  const uint64_t size = BinaryStlSize(bytes);
  const uint64_t count = (size - kHeaderBytes) / kTriangleBytes;
  if (size != bytes.size()) {
    return Malformed(Location::Byte(kHeaderBytes - 4), count, " triangles take ", size, " bytes, but the file has ",
                     bytes.size());
  }
  if (count > collector->limits().max_triangles) {
    return OverLimit(Location::Byte(kHeaderBytes - 4), absl::StrCat(count, " triangles"), "--max-triangles",
                     collector->limits().max_triangles);
  }
  collector->Reserve(0, count);
  VertexMerger merger(collector);
  for (uint64_t i = 0; i < count; ++i) {
    const Location where = Location::Byte(kHeaderBytes + i * kTriangleBytes);
    std::array<Vec3f, 3> positions;
    std::memcpy(&positions, bytes.data() + where.number + 12, sizeof(positions));
    std::array<uint32_t, 3> corners;
    for (int corner = 0; corner < 3; ++corner) {
      const absl::StatusOr<uint32_t> index = merger.Add(static_cast<Vec3d>(positions[corner]), where);
      if (!index.ok()) return index.status();
      corners[corner] = *index;
    }
    if (absl::Status status = collector->AddFace(corners, where); !status.ok()) return status;
  }
  return absl::OkStatus();
}

// Takes the word `expected`, in capitals or not, off the front of `line`.
bool TakeWord(absl::string_view expected, absl::string_view* line) {
  absl::string_view rest = *line;
  if (!absl::EqualsIgnoreCase(NextToken(&rest), expected)) return false;
  *line = rest;
  return true;
}

class AsciiReader {
 public:
  AsciiReader(absl::string_view text, FaceCollector* collector)
      : lines_(text, collector->limits().max_line_bytes), collector_(*collector), merger_(collector) {}

  absl::Status Read() {
    while (true) {
      const absl::StatusOr<bool> more = Next();
      if (!more.ok()) return more.status();
      if (!*more) return absl::OkStatus();
      if (absl::Status status = ReadLine(); !status.ok()) return status;
    }
  }

 private:
  // What the next line has to be.
  enum class Expected : uint8_t { kSolid, kFacet, kLoop, kVertex, kEndLoop, kEndFacet };

  // Sets line_ to the next line that is not blank. False at the end of the file, an error where it comes too early.
  absl::StatusOr<bool> Next() {
    while (true) {
      const absl::StatusOr<bool> more = lines_.Next(&line_);
      if (!more.ok()) return more;
      if (*more && absl::StripAsciiWhitespace(line_).empty()) continue;
      if (*more) return true;
      if (expected_ == Expected::kSolid && solids_ > 0) return false;
      return Malformed(lines_.where(), "the file ends where ", Name(expected_), " is expected");
    }
  }

  absl::Status ReadLine() {
    absl::string_view rest = line_;
    switch (expected_) {
      case Expected::kSolid:
        if (!TakeWord("solid", &rest)) break;
        expected_ = Expected::kFacet;
        ++solids_;
        return collector_.SetGroup(absl::StripAsciiWhitespace(rest), lines_.where());
      case Expected::kFacet:
        if (TakeWord("endsolid", &rest)) {
          expected_ = Expected::kSolid;
          return absl::OkStatus();
        }
        if (!TakeWord("facet", &rest)) break;
        expected_ = Expected::kLoop;
        return absl::OkStatus();
      case Expected::kLoop:
        if (!TakeWord("outer", &rest) || !TakeWord("loop", &rest)) break;
        expected_ = Expected::kVertex;
        corner_ = 0;
        return absl::OkStatus();
      case Expected::kVertex:
        if (!TakeWord("vertex", &rest)) break;
        return ReadVertex(rest);
      case Expected::kEndLoop:
        if (!TakeWord("endloop", &rest)) break;
        expected_ = Expected::kEndFacet;
        return absl::OkStatus();
      case Expected::kEndFacet:
        if (!TakeWord("endfacet", &rest)) break;
        expected_ = Expected::kFacet;
        return collector_.AddFace(corners_, lines_.where());
    }
    return Malformed(lines_.where(), Name(expected_), " is expected, not ", Quoted(line_));
  }

  absl::Status ReadVertex(absl::string_view numbers) {
    Vec3d position;
    for (int axis = 0; axis < 3; ++axis) {
      const absl::string_view token = NextToken(&numbers);
      if (!ParseDouble(token, &position[axis])) {
        return Malformed(lines_.where(), Quoted(token), " is not a number, as coordinate ", axis + 1, " of a vertex");
      }
    }
    const absl::string_view extra = NextToken(&numbers);
    if (!extra.empty()) return Malformed(lines_.where(), Quoted(extra), " follows the coordinates of a vertex");
    const absl::StatusOr<uint32_t> index = merger_.Add(position, lines_.where());
    if (!index.ok()) return index.status();
    corners_[corner_++] = *index;
    if (corner_ == 3) expected_ = Expected::kEndLoop;
    return absl::OkStatus();
  }

  static absl::string_view Name(Expected expected) {
    static constexpr absl::string_view kNames[] = {
        "\"solid\"", "\"facet\" or \"endsolid\"", "\"outer loop\"", "\"vertex\"", "\"endloop\"", "\"endfacet\""};
    return kNames[static_cast<int>(expected)];
  }

  LineCursor lines_;
  FaceCollector& collector_;
  VertexMerger merger_;
  absl::string_view line_;
  Expected expected_ = Expected::kSolid;
  uint64_t solids_ = 0;
  std::array<uint32_t, 3> corners_ = {};
  int corner_ = 0;
};

}  // namespace

uint64_t BinaryStlSize(absl::string_view bytes) {
  if (bytes.size() < kHeaderBytes) return 0;
  uint32_t count;
  std::memcpy(&count, bytes.data() + kHeaderBytes - 4, 4);
  return kHeaderBytes + uint64_t{count} * kTriangleBytes;
}

bool HasBinaryStlSize(absl::string_view bytes) { return !bytes.empty() && BinaryStlSize(bytes) == bytes.size(); }

bool BeginsAsciiStl(absl::string_view line) { return TakeWord("solid", &line); }

absl::Status ReadStl(absl::string_view bytes, FaceCollector* collector) {
  // Text has no zero bytes, and the start of a binary file that is cut off or has lost its header nearly always does.
  const bool is_text = !absl::StrContains(bytes.substr(0, 512), absl::string_view("\0", 1));
  if (HasBinaryStlSize(bytes) || !is_text) return ReadBinary(bytes, collector);
  return AsciiReader(bytes, collector).Read();
}

}  // namespace deltaray
