#include "server/mesh/ply_header.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "server/mesh/number.h"

namespace deltaray {
namespace {

// More than any real file has; it bounds the memory that a hostile header takes.
constexpr size_t kMaxProperties = 1024, kMaxElements = 1024;

bool ParseType(absl::string_view name, PlyType* type) {
  static constexpr std::pair<absl::string_view, PlyType> kTypes[] = {
      {"char", PlyType::kInt8},      {"int8", PlyType::kInt8},       {"uchar", PlyType::kUint8},
      {"uint8", PlyType::kUint8},    {"short", PlyType::kInt16},     {"int16", PlyType::kInt16},
      {"ushort", PlyType::kUint16},  {"uint16", PlyType::kUint16},   {"int", PlyType::kInt32},
      {"int32", PlyType::kInt32},    {"uint", PlyType::kUint32},     {"uint32", PlyType::kUint32},
      {"float", PlyType::kFloat32},  {"float32", PlyType::kFloat32}, {"double", PlyType::kFloat64},
      {"float64", PlyType::kFloat64}};
  for (const auto& [known, value] : kTypes) {
    if (known == name) {
      *type = value;
      return true;
    }
  }
  return false;
}

absl::Status ParseFormat(absl::string_view rest, Location where, PlyEncoding* encoding) {
  const absl::string_view name = NextToken(&rest), version = NextToken(&rest);
  if (name == "ascii") {
    *encoding = PlyEncoding::kAscii;
  } else if (name == "binary_little_endian") {
    *encoding = PlyEncoding::kLittleEndian;
  } else if (name == "binary_big_endian") {
    *encoding = PlyEncoding::kBigEndian;
  } else {
    return Malformed(where, Quoted(name), " is not a format of PLY");
  }
  if (version != "1.0") return Malformed(where, "PLY version ", Quoted(version), " is unknown; 1.0 is read");
  return absl::OkStatus();
}

absl::Status ParseElement(absl::string_view rest, Location where, std::vector<PlyElement>* elements) {
  PlyElement element;
  element.name = std::string(NextToken(&rest));
  element.where = where;
  const absl::string_view count = NextToken(&rest);
  if (element.name.empty()) return Malformed(where, "an element needs a name and a count");
  if (!ParseInteger(count, &element.count)) {
    return Malformed(where, "element ", Quoted(element.name), " has the count ", Quoted(count), ", which is none");
  }
  for (const PlyElement& other : *elements) {
    if (other.name == element.name) return Malformed(where, "element ", Quoted(element.name), " is there twice");
  }
  if (elements->size() >= kMaxElements) return OverLimit(where, "an element", "elements of a header", kMaxElements);
  elements->push_back(std::move(element));
  return absl::OkStatus();
}

absl::Status ParseProperty(absl::string_view rest, Location where, std::vector<PlyElement>* elements) {
  if (elements->empty()) return Malformed(where, "a property stands before any element");
  PlyProperty property;
  absl::string_view type = NextToken(&rest);
  if (type == "list") {
    property.is_list = true;
    const absl::string_view count_type = NextToken(&rest);
    if (!ParseType(count_type, &property.count_type) || !IsInteger(property.count_type)) {
      return Malformed(where, Quoted(count_type), " is not a type for the length of a list");
    }
    type = NextToken(&rest);
  }
  if (!ParseType(type, &property.type)) return Malformed(where, Quoted(type), " is not a type of PLY");
  property.name = std::string(NextToken(&rest));
  if (property.name.empty()) return Malformed(where, "a property needs a name");
  PlyElement& element = elements->back();
  if (element.Find(property.name) >= 0) {
    return Malformed(where, "element ", Quoted(element.name), " has property ", Quoted(property.name), " twice");
  }
  if (element.properties.size() >= kMaxProperties) {
    return OverLimit(where, "a property", "properties of an element", kMaxProperties);
  }
  element.properties.push_back(std::move(property));
  return absl::OkStatus();
}

}  // namespace

size_t SizeOf(PlyType type) {
  static constexpr size_t kSizes[] = {1, 1, 2, 2, 4, 4, 4, 8};
  return kSizes[static_cast<int>(type)];
}

bool IsInteger(PlyType type) { return type < PlyType::kFloat32; }

int PlyElement::Find(absl::string_view name) const {
  for (size_t i = 0; i < properties.size(); ++i) {
    if (properties[i].name == name) return i;
  }
  return -1;
}

uint64_t PlyElement::LeastRowBytes(PlyEncoding encoding) const {
  uint64_t bytes = 0;
  for (const PlyProperty& property : properties) {
    bytes += encoding == PlyEncoding::kAscii ? 2 : SizeOf(property.is_list ? property.count_type : property.type);
  }
  return bytes;
}

const PlyElement* PlyHeader::Find(absl::string_view name) const {
  for (const PlyElement& element : elements) {
    if (element.name == name) return &element;
  }
  return nullptr;
}

absl::StatusOr<PlyHeader> ReadPlyHeader(LineCursor* lines) {
  PlyHeader header;
  bool has_format = false;
  absl::string_view line;
  for (bool first = true;; first = false) {
    const absl::StatusOr<bool> more = lines->Next(&line);
    if (!more.ok()) return more.status();
    const Location where = lines->where();
    if (!*more) return Malformed(where, "the file ends in the header");
    absl::string_view rest = line;
    const absl::string_view keyword = NextToken(&rest);
    absl::Status status;
    if (first) {
      if (keyword != "ply") return Malformed(where, "a PLY file begins with the line \"ply\", not ", Quoted(line));
    } else if (keyword == "format") {
      status = ParseFormat(rest, where, &header.encoding);
      has_format = true;
    } else if (keyword == "element") {
      status = ParseElement(rest, where, &header.elements);
    } else if (keyword == "property") {
      status = ParseProperty(rest, where, &header.elements);
    } else if (keyword == "end_header") {
      if (!has_format) return Malformed(where, "the header has no line \"format\"");
      return header;
    } else if (keyword != "comment" && keyword != "obj_info" && !keyword.empty()) {
      return Malformed(where, Quoted(keyword), " is not a statement of a PLY header");
    }
    if (!status.ok()) return status;
  }
}

}  // namespace deltaray
