#include "server/service/mesh_messages.h"

#include <cmath>
#include <string>

#include "absl/strings/str_cat.h"

namespace deltaray {
namespace {

absl::Status NotInEnum(const char* field, int value) {
  return absl::InvalidArgumentError(absl::StrCat(field, ": ", value, " is not a value of the enum"));
}

v1::MeshState ToMessage(MeshState state) {
  switch (state) {
    case MeshState::kStored:
      return v1::MESH_STATE_STORED;
    case MeshState::kBuilding:
      return v1::MESH_STATE_BUILDING;
    case MeshState::kProvisional:
      return v1::MESH_STATE_PROVISIONAL;
    case MeshState::kReady:
      return v1::MESH_STATE_READY;
    case MeshState::kFailed:
      return v1::MESH_STATE_FAILED;
  }
  return v1::MESH_STATE_UNSPECIFIED;
}

v1::BuildPhase ToMessage(BuildPhase phase) {
  switch (phase) {
    case BuildPhase::kQueued:
      return v1::BUILD_PHASE_QUEUED;
    case BuildPhase::kReferences:
      return v1::BUILD_PHASE_REFERENCES;
    case BuildPhase::kTop:
      return v1::BUILD_PHASE_TOP;
    case BuildPhase::kDeltaLeaves:
      return v1::BUILD_PHASE_DELTA_LEAVES;
    case BuildPhase::kLayout:
      return v1::BUILD_PHASE_LAYOUT;
    case BuildPhase::kDone:
      return v1::BUILD_PHASE_DONE;
  }
  return v1::BUILD_PHASE_UNSPECIFIED;
}

void SetPoint(Vec3d p, v1::Point* point) {
  point->set_x(p.x);
  point->set_y(p.y);
  point->set_z(p.z);
}

v1::BuildPreset ToMessage(Preset preset) {
  switch (preset) {
    case Preset::kFast:
      return v1::BUILD_PRESET_FAST;
    case Preset::kBalanced:
      return v1::BUILD_PRESET_BALANCED;
    case Preset::kBest:
      return v1::BUILD_PRESET_BEST;
    case Preset::kAuto:
      return v1::BUILD_PRESET_AUTO;
  }
  return v1::BUILD_PRESET_UNSPECIFIED;
}

Preset ReadPreset(v1::BuildPreset preset) {
  switch (preset) {
    case v1::BUILD_PRESET_FAST:
      return Preset::kFast;
    case v1::BUILD_PRESET_BEST:
      return Preset::kBest;
    case v1::BUILD_PRESET_AUTO:
      return Preset::kAuto;
    default:
      return Preset::kBalanced;
  }
}

v1::TreeBuilder ToMessage(Builder builder) {
  switch (builder) {
    case Builder::kHybrid:
      return v1::TREE_BUILDER_HYBRID;
    case Builder::kKdTree:
      return v1::TREE_BUILDER_KD_TREE;
    case Builder::kBvh:
      return v1::TREE_BUILDER_BVH;
    case Builder::kSbvh:
      return v1::TREE_BUILDER_SBVH;
    case Builder::kTang2015:
      return v1::TREE_BUILDER_TANG2015;
  }
  return v1::TREE_BUILDER_UNSPECIFIED;
}

Builder ReadBuilder(v1::TreeBuilder builder) {
  switch (builder) {
    case v1::TREE_BUILDER_KD_TREE:
      return Builder::kKdTree;
    case v1::TREE_BUILDER_BVH:
      return Builder::kBvh;
    case v1::TREE_BUILDER_SBVH:
      return Builder::kSbvh;
    case v1::TREE_BUILDER_TANG2015:
      return Builder::kTang2015;
    default:
      return Builder::kHybrid;
  }
}

absl::StatusOr<RawLayout> ReadRawLayout(const v1::UploadHeader& header) {
  RawLayout raw;
  if (header.has_raw_layout() != (header.format() == v1::MESH_FORMAT_RAW)) {
    return absl::InvalidArgumentError(header.has_raw_layout()
                                          ? "header.raw_layout: must be unset unless format is MESH_FORMAT_RAW"
                                          : "header.raw_layout: must be set for MESH_FORMAT_RAW");
  }
  const v1::RawLayout& layout = header.raw_layout();
  if (!v1::ScalarType_IsValid(layout.position_type())) {
    return NotInEnum("header.raw_layout.position_type", layout.position_type());
  }
  raw.vertex_count = layout.vertex_count();
  raw.triangle_count = layout.triangle_count();
  raw.float64 = layout.position_type() == v1::SCALAR_TYPE_FLOAT64;
  return raw;
}

MeshFormat ReadFormat(v1::MeshFormat format) {
  switch (format) {
    case v1::MESH_FORMAT_OBJ:
      return MeshFormat::kObj;
    case v1::MESH_FORMAT_PLY:
      return MeshFormat::kPly;
    case v1::MESH_FORMAT_STL:
      return MeshFormat::kStl;
    case v1::MESH_FORMAT_RAW:
      return MeshFormat::kRaw;
    default:
      return MeshFormat::kDetect;
  }
}

}  // namespace

absl::StatusOr<Config> ReadBuildOptions(const v1::BuildOptions& options) {
  if (!v1::BuildPreset_IsValid(options.preset())) return NotInEnum("build_options.preset", options.preset());
  if (!v1::TreeBuilder_IsValid(options.builder())) return NotInEnum("build_options.builder", options.builder());
  const Builder builder = ReadBuilder(options.builder());
  const Preset preset = ReadPreset(options.preset());
  Config config = MakeConfig(builder, preset);
  // 0 would leave it to the mesh, which only an unset field does.
  if (options.has_delta() && options.delta() == kDeltaByMesh) {
    return absl::InvalidArgumentError("build_options.delta is 0; it must be 1 to 4096");
  }
  if (options.has_delta()) config.delta = options.delta();
  if (options.has_alpha()) config.alpha = options.alpha();
  if (options.has_traversal_cost()) config.traversal_cost = options.traversal_cost();
  if (options.has_intersection_cost()) config.intersection_cost = options.intersection_cost();
  if (builder == Builder::kTang2015) {
    // The paper has one Ct and one Ci, for splits and for clusters.
    if (options.has_traversal_cost()) config.cluster_traversal_cost = options.traversal_cost();
    if (options.has_intersection_cost()) config.cluster_intersection_cost = options.intersection_cost();
  }
  if (options.has_lazy()) config.lazy = options.lazy();
  if (config.lazy && builder != Builder::kHybrid) {
    return absl::InvalidArgumentError("build_options.lazy: only TREE_BUILDER_HYBRID can be built lazily");
  }
  if (absl::Status status = Validate(config); !status.ok()) {
    return absl::Status(status.code(), absl::StrCat("build_options.", status.message()));
  }
  return config;
}

v1::BuildOptions ToMessage(const Config& config) {
  v1::BuildOptions options;
  options.set_preset(ToMessage(config.preset));
  options.set_builder(ToMessage(config.builder));
  if (config.delta != kDeltaByMesh) options.set_delta(config.delta);
  options.set_alpha(config.alpha);
  options.set_traversal_cost(config.traversal_cost);
  options.set_intersection_cost(config.intersection_cost);
  options.set_lazy(config.lazy);
  return options;
}

v1::Mesh ToMessage(const MeshInfo& info) {
  v1::Mesh mesh;
  mesh.set_id(info.id);
  for (const std::string& name : info.names) mesh.add_names(name);
  mesh.set_vertex_count(info.vertex_count);
  mesh.set_triangle_count(info.triangle_count);
  mesh.set_face_count(info.face_count);
  mesh.set_degenerate_triangle_count(info.report.degenerate_triangles);
  if (!info.report.bounds.IsEmpty()) {
    SetPoint(static_cast<Vec3d>(info.report.bounds.min) + info.origin, mesh.mutable_bounds()->mutable_min());
    SetPoint(static_cast<Vec3d>(info.report.bounds.max) + info.origin, mesh.mutable_bounds()->mutable_max());
  }
  SetPoint(info.origin, mesh.mutable_origin());
  mesh.set_max_rounding(info.report.max_rounding);
  mesh.set_state(ToMessage(info.state));
  *mesh.mutable_build_options() = ToMessage(info.config);
  const auto since_epoch = info.created.time_since_epoch();
  const auto seconds = std::chrono::floor<std::chrono::seconds>(since_epoch);
  mesh.mutable_create_time()->set_seconds(seconds.count());
  mesh.mutable_create_time()->set_nanos(
      static_cast<int32_t>(std::chrono::duration_cast<std::chrono::nanoseconds>(since_epoch - seconds).count()));
  mesh.set_stored_bytes(info.stored_bytes);
  for (const std::string& group : info.groups) mesh.add_groups(group);
  for (const std::string& warning : info.report.warnings) mesh.add_warnings(warning);
  mesh.set_failure(info.failure);
  return mesh;
}

v1::BuildProgress ToMessage(const BuildReport& report) {
  v1::BuildProgress progress;
  progress.set_state(ToMessage(report.state));
  progress.set_build_number(report.build_number);
  if (report.build_number != 0) progress.set_phase(ToMessage(report.progress.phase));
  progress.set_references_placed(report.progress.references_placed);
  progress.set_triangles(report.progress.triangles);
  progress.set_delta_leaves(report.progress.delta_leaves);
  progress.set_delta_leaves_built(report.progress.delta_leaves_built);
  progress.set_elapsed_seconds(report.progress.elapsed_seconds);
  progress.set_failure(report.failure);
  return progress;
}

v1::BuildStats ToMessage(const StoredStatistics& stored) {
  const BuildStatistics& statistics = stored.statistics;
  v1::BuildStats stats;
  *stats.mutable_options() = ToMessage(statistics.config);
  stats.set_build_number(stored.build_number);
  for (const PhaseTime& time : statistics.phases) {
    v1::PhaseTime* phase = stats.add_phases();
    phase->set_phase(ToMessage(time.phase));
    phase->set_wall_seconds(time.wall_seconds);
    phase->set_cpu_seconds(time.cpu_seconds);
  }
  stats.set_provisional_seconds(statistics.provisional_seconds);
  stats.set_first_answer_seconds(stored.first_answer_seconds);
  stats.set_total_seconds(statistics.total_seconds);
  stats.set_threads(statistics.threads);
  stats.set_triangles(statistics.triangles);
  stats.set_references(statistics.shape.references);
  stats.set_spatial_splits(statistics.spatial_splits);
  stats.set_object_splits(statistics.object_splits);
  stats.set_median_splits(statistics.median_splits);
  stats.set_delta_leaves(statistics.delta_leaves);
  stats.set_delta_leaves_built(statistics.delta_leaves_built);
  for (uint64_t count : statistics.delta_leaf_size_histogram) stats.add_delta_leaf_size_histogram(count);
  const auto wins = [&](DeltaLeafCandidate candidate) {
    return statistics.candidate_wins[static_cast<size_t>(candidate)];
  };
  v1::CandidateWins* candidate_wins = stats.mutable_candidate_wins();
  candidate_wins->set_combined_cost(wins(DeltaLeafCandidate::kCombinedCost));
  candidate_wins->set_area_only(wins(DeltaLeafCandidate::kAreaOnly));
  candidate_wins->set_distance_only(wins(DeltaLeafCandidate::kDistanceOnly));
  candidate_wins->set_top_down(wins(DeltaLeafCandidate::kTopDown));
  stats.set_nodes(statistics.shape.nodes);
  stats.set_leaves(statistics.shape.leaves);
  stats.set_max_depth(statistics.shape.max_depth);
  stats.set_sah_cost(statistics.shape.sah_cost);
  stats.set_node_bytes(statistics.shape.node_bytes);
  stats.set_reference_bytes(statistics.shape.reference_bytes);
  stats.set_mesh_bytes(stored.mesh_bytes);
  stats.set_peak_build_bytes(statistics.peak_build_bytes);
  for (const std::string& choice : statistics.choices) stats.add_choices(choice);
  return stats;
}

absl::StatusOr<Upload::CommitOptions> ReadUploadHeader(const v1::UploadHeader& header, uint64_t max_upload_bytes) {
  Upload::CommitOptions options;
  if (!header.name().empty()) {
    if (absl::Status status = ValidateMeshName(header.name()); !status.ok()) {
      return absl::Status(status.code(), absl::StrCat("header.name: ", status.message()));
    }
    options.name = header.name();
  }
  if (!v1::MeshFormat_IsValid(header.format())) return NotInEnum("header.format", header.format());
  options.read.format = ReadFormat(header.format());
  absl::StatusOr<RawLayout> raw = ReadRawLayout(header);
  if (!raw.ok()) return raw.status();
  options.read.raw = *raw;
  if (header.has_size_bytes()) {
    if (header.size_bytes() > max_upload_bytes) {
      return absl::ResourceExhaustedError(absl::StrCat("header.size_bytes: ", header.size_bytes(),
                                                       " is over the limit of ", max_upload_bytes,
                                                       " bytes an upload (--max-upload-bytes)"));
    }
    options.size = header.size_bytes();
  }
  if (!header.sha256().empty() && header.sha256().size() != 32) {
    return absl::InvalidArgumentError(
        absl::StrCat("header.sha256: ", header.sha256().size(), " bytes, neither 32 nor none"));
  }
  options.sha256 = header.sha256();
  if (header.has_build_options()) {
    absl::StatusOr<Config> config = ReadBuildOptions(header.build_options());
    if (!config.ok()) return absl::Status(config.status().code(), absl::StrCat("header.", config.status().message()));
    options.config = *config;
  }
  return options;
}

}  // namespace deltaray
