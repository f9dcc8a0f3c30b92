#include "server/mesh/face_collector.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/mesh/finish_mesh.h"
#include "server/mesh/utf8.h"

namespace deltaray {

FaceCollector::FaceCollector(const ReadMeshOptions& options, uint32_t first_index)
    : options_(options), first_index_(first_index) {}

absl::Status FaceCollector::AddVertex(const Vec3d& position, Location where) {
  if (vertex_count() >= std::min(limits().max_vertices, kMaxMeshCount)) {
    return OverLimit(where, absl::StrCat(vertex_count() + 1, " vertices"), "--max-vertices", limits().max_vertices);
  }
  for (int axis = 0; axis < 3; ++axis) {
    if (!std::isfinite(static_cast<float>(position[axis]))) {
      return Malformed(where, absl::string_view("xyz").substr(axis, 1), " = ", position[axis],
                       " is not a number in the range of float32");
    }
  }
  if (absl::Status status = TakeMemory(0); !status.ok()) return status;
  mesh_.vertices.push_back(position);
  return Poll();
}

absl::Status FaceCollector::AddFace(std::span<const uint32_t> corners, Location where) {
  if (corners.size() < 3) return Malformed(where, "a face needs 3 corners or more and has ", corners.size());
  if (corners.size() > limits().max_face_corners) {
    return OverLimit(where, absl::StrCat("a face of ", corners.size(), " corners"), "--max-face-corners",
                     limits().max_face_corners);
  }
  triangle_count_ += corners.size() - 2;
  if (triangle_count_ > std::min(limits().max_triangles, kMaxMeshCount)) {
    return OverLimit(where, absl::StrCat(triangle_count_, " triangles"), "--max-triangles", limits().max_triangles);
  }
  if (absl::Status status = TakeMemory(corners.size()); !status.ok()) return status;
  for (const uint32_t corner : corners) {
    if (corner < vertex_count() || corner < vertices_needed_) continue;
    vertices_needed_ = uint64_t{corner} + 1;
    vertices_needed_where_ = where;
  }
  if (!group_entered_) {
    if (absl::Status status = EnterGroup(where); !status.ok()) return status;
  }
  // Sizes and groups are kept only from the first face on that is not an ungrouped triangle.
  if (corners.size() != 3 && mesh_.face_sizes.empty()) mesh_.face_sizes.assign(mesh_.face_count, 3);
  if (corners.size() != 3 || !mesh_.face_sizes.empty()) mesh_.face_sizes.push_back(corners.size());
  if (current_group_ != kNoGroup && mesh_.face_groups.empty()) mesh_.face_groups.assign(mesh_.face_count, kNoGroup);
  if (current_group_ != kNoGroup || !mesh_.face_groups.empty()) mesh_.face_groups.push_back(current_group_);
  mesh_.corners.insert(mesh_.corners.end(), corners.begin(), corners.end());
  ++mesh_.face_count;
  return Poll();
}

absl::Status FaceCollector::SetGroup(absl::string_view name, Location where) {
  if (name.size() > limits().max_group_name_bytes) {
    return OverLimit(where, absl::StrCat("a group name of ", name.size(), " bytes"), "--max-group-name-bytes",
                     limits().max_group_name_bytes);
  }
  group_name_ = ToValidUtf8(name);
  if (group_name_ != name) {
    Warn(absl::StrCat(where.ToString(), ": the group name ", Quoted(name), " is not printable UTF-8; bytes replaced."));
  }
  group_entered_ = false;
  return absl::OkStatus();
}

absl::Status FaceCollector::EnterGroup(Location where) {
  group_entered_ = true;
  current_group_ = kNoGroup;
  if (group_name_.empty()) return absl::OkStatus();
  const auto [entry, is_new] = group_index_.try_emplace(group_name_, mesh_.groups.size());
  if (is_new) {
    if (mesh_.groups.size() >= limits().max_groups) {
      return OverLimit(where, absl::StrCat(mesh_.groups.size() + 1, " groups"), "--max-groups", limits().max_groups);
    }
    group_bytes_ += group_name_.size();
    if (group_bytes_ > limits().max_group_bytes) {
      return OverLimit(where, absl::StrCat("group names of ", group_bytes_, " bytes in all"), "--max-group-bytes",
                       limits().max_group_bytes);
    }
    mesh_.groups.push_back(group_name_);
  }
  current_group_ = entry->second;
  return absl::OkStatus();
}

absl::Status FaceCollector::Poll() {
  if (polls_++ % 4096 == 0 && options_.cancelled && options_.cancelled()) {
    return absl::CancelledError("reading the mesh was cancelled");
  }
  return absl::OkStatus();
}

absl::Status FaceCollector::TakeMemory(uint64_t corners) {
  // An array that grows is there twice, the new one with twice the room. A merger has an index for each vertex. The
  // triangles of the finished mesh stand beside the faces that they are made of.
  constexpr uint64_t kGrowing = 3, kMerged = 17, kTriangle = 12, kStep = uint64_t{1} << 20;
  const uint64_t arrays = sizeof(Vec3d) * (mesh_.vertices.size() + 1) +
                          4 * (mesh_.corners.size() + corners + mesh_.face_sizes.size() + mesh_.face_groups.size());
  const uint64_t needed =
      kGrowing * (arrays + group_bytes_) + kMerged * mesh_.vertices.size() + kTriangle * triangle_count_;
  if (needed <= memory_taken_ || !options_.take_memory) return absl::OkStatus();
  memory_taken_ = needed + needed / 4 + kStep;
  return options_.take_memory(memory_taken_);
}

void FaceCollector::Reserve(uint64_t vertices, uint64_t faces) {
  mesh_.vertices.reserve(std::min(vertices, limits().max_vertices));
  mesh_.corners.reserve(3 * std::min(faces, limits().max_triangles));
}

absl::StatusOr<ReadMeshResult> FaceCollector::Finish() {
  if (vertices_needed_ > vertex_count()) {
    return Malformed(vertices_needed_where_, "a face names vertex ", vertices_needed_ - 1 + first_index_,
                     ", but the file has ", vertex_count(), " vertices, counted from ", first_index_);
  }
  return FinishMesh(std::move(mesh_), std::move(warnings_), options_.cancelled);
}

}  // namespace deltaray
