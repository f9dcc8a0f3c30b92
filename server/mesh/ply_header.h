// The header of a PLY file.

#ifndef SERVER_MESH_PLY_HEADER_H_
#define SERVER_MESH_PLY_HEADER_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/mesh/line_cursor.h"
#include "server/mesh/location.h"

namespace deltaray {

enum class PlyEncoding : uint8_t { kAscii, kLittleEndian, kBigEndian };

enum class PlyType : uint8_t { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat32, kFloat64 };

// Bytes of a value in a binary file: 1, 2, 4 or 8.
size_t SizeOf(PlyType type);
bool IsInteger(PlyType type);

struct PlyProperty {
  std::string name;
  PlyType type = PlyType::kInt8;  // of the value, or of each value of the list
  bool is_list = false;
  PlyType count_type = PlyType::kInt8;  // of a list's length; an integer type
};

struct PlyElement {
  std::string name;
  uint64_t count = 0;
  std::vector<PlyProperty> properties;
  Location where;  // its line of the header

  // Index of the property `name`, or -1.
  int Find(absl::string_view name) const;
  // The least number of bytes of a row: lists are empty, numbers have one digit and one space after it.
  uint64_t LeastRowBytes(PlyEncoding encoding) const;
};

struct PlyHeader {
  PlyEncoding encoding = PlyEncoding::kAscii;
  std::vector<PlyElement> elements;

  // The element `name`, or null.
  const PlyElement* Find(absl::string_view name) const;
};

// Reads the header, up to and with the line end_header, which leaves `lines` at the start of the body. INVALID_ARGUMENT
// naming the line for what is malformed.
absl::StatusOr<PlyHeader> ReadPlyHeader(LineCursor* lines);

}  // namespace deltaray

#endif  // SERVER_MESH_PLY_HEADER_H_
