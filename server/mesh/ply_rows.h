// The values of a PLY body, row by row.

#ifndef SERVER_MESH_PLY_ROWS_H_
#define SERVER_MESH_PLY_ROWS_H_

#include <algorithm>
#include <bit>
#include <cstdint>
#include <cstring>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "server/mesh/line_cursor.h"
#include "server/mesh/number.h"
#include "server/mesh/ply_header.h"

namespace deltaray {

// The body of an ASCII file: a line per row, values between spaces.
class AsciiPlyRows {
 public:
  explicit AsciiPlyRows(LineCursor lines) : lines_(lines) {}

  // Goes to the next line that is not blank. False at the end of the file.
  absl::StatusOr<bool> Next() {
    do {
      const absl::StatusOr<bool> more = lines_.Next(&rest_);
      if (!more.ok() || !*more) return more;
    } while (rest_.find_first_not_of(" \t") == absl::string_view::npos);
    return true;
  }
  absl::Status Read(const PlyProperty& property, PlyType, double* value) {
    const absl::string_view token = NextToken(&rest_);
    if (token.empty()) return Malformed(where(), "the line ends before property ", Quoted(property.name), " does");
    if (!ParseDouble(token, value)) {
      return Malformed(where(), Quoted(token), " is not a number, in property ", Quoted(property.name));
    }
    return absl::OkStatus();
  }
  // Passes over `count` values, which need not be numbers.
  absl::Status Skip(const PlyProperty& property, PlyType, uint64_t count) {
    for (; count > 0; --count) {
      if (!NextToken(&rest_).empty()) continue;
      return Malformed(where(), "the line ends before property ", Quoted(property.name), " does");
    }
    return absl::OkStatus();
  }
  absl::Status EndRow() {
    const absl::string_view extra = NextToken(&rest_);
    return extra.empty() ? absl::OkStatus()
                         : Malformed(where(), Quoted(extra), " follows the last property of the row");
  }
  // Offset of the first byte that was not read yet.
  size_t position() const { return lines_.position(); }
  // The current row.
  Location where() const { return lines_.where(); }

 private:
  LineCursor lines_;
  absl::string_view rest_;  // of the current line
};

// The body of a binary file: values without gaps, from byte `position` on.
class BinaryPlyRows {
 public:
  BinaryPlyRows(absl::string_view bytes, size_t position, PlyEncoding encoding)
      : bytes_(bytes), position_(position), row_(position), swap_(encoding != kNative) {}

  absl::StatusOr<bool> Next() {
    row_ = position_;
    return position_ < bytes_.size();
  }
  absl::Status Read(const PlyProperty& property, PlyType type, double* value) {
    const char* begin = bytes_.data() + position_;
    if (absl::Status status = Skip(property, type, 1); !status.ok()) return status;
    char copy[8];
    if (swap_) {
      std::reverse_copy(begin, begin + SizeOf(type), copy);
    } else {
      std::copy(begin, begin + SizeOf(type), copy);
    }
    *value = Convert(copy, type);
    return absl::OkStatus();
  }
  absl::Status Skip(const PlyProperty& property, PlyType type, uint64_t count) {
    if (count > (bytes_.size() - position_) / SizeOf(type)) {
      return Malformed(Location::Byte(position_), "the file ends in property ", Quoted(property.name),
                       " of the row at byte ", row_);
    }
    position_ += count * SizeOf(type);
    return absl::OkStatus();
  }
  absl::Status EndRow() { return absl::OkStatus(); }
  size_t position() const { return position_; }
  Location where() const { return Location::Byte(row_); }

 private:
  static constexpr PlyEncoding kNative =
      std::endian::native == std::endian::little ? PlyEncoding::kLittleEndian : PlyEncoding::kBigEndian;

  template <typename T>
  static double As(const char* bytes) {
    T value;
    std::memcpy(&value, bytes, sizeof(T));
    return value;
  }
  static double Convert(const char* bytes, PlyType type) {
    switch (type) {
      case PlyType::kInt8:
        return As<int8_t>(bytes);
      case PlyType::kUint8:
        return As<uint8_t>(bytes);
      case PlyType::kInt16:
        return As<int16_t>(bytes);
      case PlyType::kUint16:
        return As<uint16_t>(bytes);
      case PlyType::kInt32:
        return As<int32_t>(bytes);
      case PlyType::kUint32:
        return As<uint32_t>(bytes);
      case PlyType::kFloat32:
        return As<float>(bytes);
      case PlyType::kFloat64:
        break;
    }
    return As<double>(bytes);
  }

  absl::string_view bytes_;
  size_t position_;
  size_t row_;  // where the current row begins
  bool swap_;
};

}  // namespace deltaray

#endif  // SERVER_MESH_PLY_ROWS_H_
