// Where in a file something stands, for the texts of errors.

#ifndef SERVER_MESH_LOCATION_H_
#define SERVER_MESH_LOCATION_H_

#include <cstdint>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"

namespace deltaray {

// A line of a text file, counted from 1, or a byte of a binary one, counted from 0.
struct Location {
  enum class Unit : uint8_t { kLine, kByte };
  Unit unit = Unit::kLine;
  uint64_t number = 1;

  static Location Line(uint64_t number) { return {Unit::kLine, number}; }
  static Location Byte(uint64_t number) { return {Unit::kByte, number}; }

  std::string ToString() const { return absl::StrCat(unit == Unit::kLine ? "line " : "byte ", number); }
};

// INVALID_ARGUMENT: "line 3: " and the parts.
template <typename... Parts>
absl::Status Malformed(Location where, const Parts&... parts) {
  return absl::InvalidArgumentError(absl::StrCat(where.ToString(), ": ", parts...));
}

// RESOURCE_EXHAUSTED: "WHERE: WHAT, more than VALUE (NAME)". The name is the server's flag where there is one.
inline absl::Status OverLimit(absl::string_view where, absl::string_view what, absl::string_view name, uint64_t value) {
  return absl::ResourceExhaustedError(absl::StrCat(where, ": ", what, ", more than ", value, " (", name, ")"));
}
inline absl::Status OverLimit(Location where, absl::string_view what, absl::string_view name, uint64_t value) {
  return OverLimit(where.ToString(), what, name, value);
}

// Text of the file, or of a client, in quotes, escaped to ASCII and cut short, so that it may stand in an error.
inline std::string Quoted(absl::string_view text) {
  constexpr size_t kLongest = 40;
  return absl::StrCat("\"", absl::CHexEscape(text.substr(0, kLongest)), text.size() > kLongest ? "..." : "", "\"");
}

}  // namespace deltaray

#endif  // SERVER_MESH_LOCATION_H_
