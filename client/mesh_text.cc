#include "client/mesh_text.h"

#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/enum_names.h"
#include "client/text_table.h"
#include "google/protobuf/util/time_util.h"

namespace deltaray {
namespace {

// Of many groups or warnings, so many are shown.
constexpr int kMaxShown = 20;

std::string TimeText(const google::protobuf::Timestamp& time) {
  return google::protobuf::util::TimeUtil::ToString(
      google::protobuf::util::TimeUtil::SecondsToTimestamp(time.seconds()));
}

// Nine digits tell coordinates far from zero apart; --format json has all.
std::string PointText(const v1::Point& point) {
  return absl::StrFormat("%.9g %.9g %.9g", point.x(), point.y(), point.z());
}

void AddStrings(TextTable& table, const std::string& label,
                const google::protobuf::RepeatedPtrField<std::string>& strings) {
  for (int i = 0; i < strings.size() && i < kMaxShown; ++i) table.Add({i == 0 ? label : "", strings[i]});
  if (strings.size() > kMaxShown) table.Add({"", absl::StrCat("and ", strings.size() - kMaxShown, " more")});
}

}  // namespace

std::string MeshListText(const google::protobuf::RepeatedPtrField<v1::Mesh>& meshes) {
  if (meshes.empty()) return "";
  TextTable table({Align::kLeft, Align::kRight, Align::kLeft, Align::kLeft, Align::kLeft, Align::kLeft});
  table.Add({"NAMES", "TRIANGLES", "STATE", "BUILDER", "CREATED", "ID"});
  for (const v1::Mesh& mesh : meshes) {
    table.Add({mesh.names().empty() ? "-" : absl::StrJoin(mesh.names(), ","), GroupDigits(mesh.triangle_count()),
               EnumName(mesh.state()), BuildOptionsText(mesh.build_options()), TimeText(mesh.create_time()),
               mesh.id()});
  }
  return table.Render();
}

std::string MeshText(const v1::Mesh& mesh) {
  TextTable table({Align::kLeft, Align::kLeft});
  table.Add({"id", mesh.id()});
  table.Add({"names", mesh.names().empty() ? "-" : absl::StrJoin(mesh.names(), ", ")});
  table.Add({"vertices", GroupDigits(mesh.vertex_count())});
  std::string triangles = GroupDigits(mesh.triangle_count());
  if (mesh.degenerate_triangle_count() > 0) {
    absl::StrAppend(&triangles, " (", GroupDigits(mesh.degenerate_triangle_count()), " degenerate)");
  }
  table.Add({"triangles", triangles});
  table.Add({"faces", GroupDigits(mesh.face_count())});
  if (mesh.has_bounds()) {
    table.Add({"bounds", absl::StrCat(PointText(mesh.bounds().min()), "  to  ", PointText(mesh.bounds().max()))});
  }
  table.Add({"origin", PointText(mesh.origin())});
  table.Add({"max rounding", absl::StrCat(mesh.max_rounding())});
  table.Add({"state", EnumName(mesh.state())});
  if (!mesh.failure().empty()) table.Add({"failure", mesh.failure()});
  table.Add({"build options", BuildOptionsText(mesh.build_options())});
  table.Add({"created", TimeText(mesh.create_time())});
  table.Add({"stored", BytesText(mesh.stored_bytes())});
  AddStrings(table, "groups", mesh.groups());
  AddStrings(table, "warnings", mesh.warnings());
  return table.Render();
}

std::string BuildOptionsText(const v1::BuildOptions& options) {
  std::vector<std::string> parts;
  // The contract names what unset means.
  parts.push_back(
      EnumName(options.builder() == v1::TREE_BUILDER_UNSPECIFIED ? v1::TREE_BUILDER_HYBRID : options.builder()));
  parts.push_back(
      EnumName(options.preset() == v1::BUILD_PRESET_UNSPECIFIED ? v1::BUILD_PRESET_BALANCED : options.preset()));
  if (options.has_delta()) parts.push_back(absl::StrCat("delta ", options.delta()));
  if (options.has_alpha()) parts.push_back(absl::StrCat("alpha ", options.alpha()));
  if (options.has_traversal_cost()) parts.push_back(absl::StrCat("Ct ", options.traversal_cost()));
  if (options.has_intersection_cost()) parts.push_back(absl::StrCat("Ci ", options.intersection_cost()));
  if (options.lazy()) parts.push_back("lazy");
  return absl::StrJoin(parts, ", ");
}

}  // namespace deltaray
