#include "server/mesh/ply_reader.h"

#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "server/mesh/ply_header.h"
#include "server/mesh/ply_rows.h"

namespace deltaray {
namespace {

// What to do with a property.
enum class Role : uint8_t { kX, kY, kZ, kCorners, kPass };

struct Plan {
  std::vector<Role> roles;  // of each property
  bool vertices = false, faces = false;
};

// The values of one row that count.
struct Row {
  Vec3d position;
  std::vector<uint32_t> corners;
};

absl::StatusOr<Plan> PlanVertices(const PlyElement& element) {
  Plan plan{std::vector<Role>(element.properties.size(), Role::kPass)};
  plan.vertices = true;
  for (int axis = 0; axis < 3; ++axis) {
    const absl::string_view name = absl::string_view("xyz").substr(axis, 1);
    const int index = element.Find(name);
    if (index < 0) return Malformed(element.where, "element \"vertex\" has no property \"", name, "\"");
    if (element.properties[index].is_list) return Malformed(element.where, "property \"", name, "\" is a list");
    plan.roles[index] = static_cast<Role>(axis);
  }
  return plan;
}

absl::StatusOr<Plan> PlanFaces(const PlyElement& element) {
  Plan plan{std::vector<Role>(element.properties.size(), Role::kPass)};
  plan.faces = true;
  const int index = std::max(element.Find("vertex_indices"), element.Find("vertex_index"));
  if (index < 0) return Malformed(element.where, "element \"face\" has no property \"vertex_indices\"");
  const PlyProperty& property = element.properties[index];
  if (!property.is_list || !IsInteger(property.type)) {
    return Malformed(element.where, "property ", Quoted(property.name), " is not a list of integers");
  }
  plan.roles[index] = Role::kCorners;
  return plan;
}

// Counts over the limits are refused before anything is read.
absl::StatusOr<Plan> MakePlan(const PlyElement& element, const MeshLimits& limits) {
  if (element.name == "vertex") {
    if (element.count > limits.max_vertices) {
      return OverLimit(element.where, absl::StrCat(element.count, " vertices"), "--max-vertices", limits.max_vertices);
    }
    return PlanVertices(element);
  }
  if (element.name == "face") {
    if (element.count > limits.max_triangles) {
      return OverLimit(element.where, absl::StrCat(element.count, " faces"), "--max-triangles", limits.max_triangles);
    }
    return PlanFaces(element);
  }
  if (element.name == "tristrips" && element.count > 0) {
    return Malformed(element.where, "triangle strips (element \"tristrips\") are not read; only faces are");
  }
  return Plan{std::vector<Role>(element.properties.size(), Role::kPass)};
}

template <typename Rows>
absl::Status ReadLength(const PlyProperty& property, Rows* rows, uint64_t* length) {
  double value = 0;
  if (absl::Status status = rows->Read(property, property.count_type, &value); !status.ok()) return status;
  if (!(value >= 0 && value <= 0xFFFFFFFF && value == std::trunc(value))) {
    return Malformed(rows->where(), "the length of list ", Quoted(property.name), " is ", value);
  }
  *length = static_cast<uint64_t>(value);
  return absl::OkStatus();
}

template <typename Rows>
absl::Status ReadCorners(const PlyProperty& property, Rows* rows, std::vector<uint32_t>* corners) {
  uint64_t length = 0;
  if (absl::Status status = ReadLength(property, rows, &length); !status.ok()) return status;
  corners->clear();
  for (; length > 0; --length) {
    double value = 0;
    if (absl::Status status = rows->Read(property, property.type, &value); !status.ok()) return status;
    if (!(value >= 0 && value <= 0xFFFFFFFF && value == std::trunc(value))) {
      return Malformed(rows->where(), "a face names vertex ", value, ", which is not an index");
    }
    corners->push_back(static_cast<uint32_t>(value));
  }
  return absl::OkStatus();
}

template <typename Rows>
absl::Status ReadRow(const PlyElement& element, const Plan& plan, Rows* rows, Row* row) {
  for (size_t i = 0; i < element.properties.size(); ++i) {
    const PlyProperty& property = element.properties[i];
    absl::Status status;
    uint64_t length = 1;
    switch (plan.roles[i]) {
      case Role::kX:
      case Role::kY:
      case Role::kZ:
        status = rows->Read(property, property.type, &row->position[static_cast<int>(plan.roles[i])]);
        break;
      case Role::kCorners:
        status = ReadCorners(property, rows, &row->corners);
        break;
      case Role::kPass:
        if (property.is_list) status = ReadLength(property, rows, &length);
        if (status.ok()) status = rows->Skip(property, property.type, length);
        break;
    }
    if (!status.ok()) return status;
  }
  return rows->EndRow();
}

template <typename Rows>
absl::Status ReadElement(const PlyElement& element, const Plan& plan, Rows* rows, FaceCollector* collector) {
  Row row;
  for (uint64_t i = 0; i < element.count; ++i) {
    if (absl::Status status = collector->Poll(); !status.ok()) return status;
    const absl::StatusOr<bool> more = rows->Next();
    if (!more.ok()) return more.status();
    if (!*more) {
      return Malformed(rows->where(), "the file ends after ", i, " of ", element.count, " rows of element ",
                       Quoted(element.name));
    }
    absl::Status status = ReadRow(element, plan, rows, &row);
    if (status.ok() && plan.vertices) status = collector->AddVertex(row.position, rows->where());
    if (status.ok() && plan.faces) status = collector->AddFace(row.corners, rows->where());
    if (!status.ok()) return status;
  }
  return absl::OkStatus();
}

template <typename Rows>
absl::Status ReadBody(absl::string_view bytes, const PlyHeader& header, Rows rows, FaceCollector* collector) {
  for (const PlyElement& element : header.elements) {
    const absl::StatusOr<Plan> plan = MakePlan(element, collector->limits());
    if (!plan.ok()) return plan.status();
    if (element.properties.empty()) continue;
    // A count that the file is too short for is refused at once, and never has memory set aside for it.
    const uint64_t left = bytes.size() - rows.position();
    const uint64_t least = element.LeastRowBytes(header.encoding);
    if (element.count > (left + 1) / least) {
      return Malformed(Location::Byte(rows.position()), "the file ends in element ", Quoted(element.name), ", whose ",
                       element.count, " rows take ", least, " bytes each or more; ", left, " are left");
    }
    collector->Reserve(plan->vertices ? element.count : 0, plan->faces ? element.count : 0);
    if (absl::Status status = ReadElement(element, *plan, &rows, collector); !status.ok()) return status;
  }
  const size_t end = bytes.find_last_not_of(" \t\r\n") + 1;
  if (rows.position() < end) {
    collector->Warn(absl::StrCat(bytes.size() - rows.position(), " bytes after the last element are passed over."));
  }
  return absl::OkStatus();
}

}  // namespace

bool LooksLikePly(absl::string_view bytes) {
  absl::ConsumePrefix(&bytes, "\xEF\xBB\xBF");
  return absl::ConsumePrefix(&bytes, "ply") && !bytes.empty() && absl::StrContains(" \t\r\n", bytes.substr(0, 1));
}

absl::Status ReadPly(absl::string_view bytes, FaceCollector* collector) {
  LineCursor lines(bytes, collector->limits().max_line_bytes);
  const absl::StatusOr<PlyHeader> header = ReadPlyHeader(&lines);
  if (!header.ok()) return header.status();
  if (header->Find("vertex") == nullptr) return Malformed(lines.where(), "the header has no element \"vertex\"");
  if (header->encoding == PlyEncoding::kAscii) return ReadBody(bytes, *header, AsciiPlyRows(lines), collector);
  return ReadBody(bytes, *header, BinaryPlyRows(bytes, lines.position(), header->encoding), collector);
}

}  // namespace deltaray
