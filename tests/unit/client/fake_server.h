// An in-process server of the contract, as simple as serves the client's tests: meshes without geometry, and a world
// whose only triangle is the plane z = 0, primitive 7.

#ifndef TESTS_UNIT_CLIENT_FAKE_SERVER_H_
#define TESTS_UNIT_CLIENT_FAKE_SERVER_H_

#include <chrono>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "deltaray/v1/mesh_service.grpc.pb.h"
#include "deltaray/v1/ray_service.grpc.pb.h"
#include "grpc/health/v1/health.grpc.pb.h"
#include "grpcpp/server.h"
#include "grpcpp/server_builder.h"

namespace deltaray {

// How the fake misbehaves, and what it saw. Set before a call, read after it.
struct FakeBehaviour {
  // StreamRays: end with this, or with OK, before reading batch number `fail_at_batch`.
  grpc::Status stream_status;
  uint64_t fail_at_batch = ~uint64_t{0};
  // StreamRays, WatchBuild after its first report, ListMeshes, DeleteMesh and Check: so many calls fail; the first with
  // stream_status, the others with UNAVAILABLE.
  int stream_failures = std::numeric_limits<int>::max();
  int watch_failures = 0;
  int list_failures = 0;
  int delete_failures = 0;
  int health_failures = 0;
  // StreamRays: the id that each stream after the first one answers for, where not empty.
  std::string moved_mesh;
  // StreamRays: number of the first reply, where not 0 a wrong one.
  uint64_t first_batch_number = 0;
  // StreamRays: added to the count in the trailing metadata.
  uint64_t extra_batches = 0;
  // WatchBuild ends with this state.
  v1::MeshState final_state = v1::MESH_STATE_READY;
  // UploadMesh: so many calls fail with this after the header.
  grpc::Status upload_status;
  int upload_failures = std::numeric_limits<int>::max();
  // ListMeshes sleeps so long.
  int list_delay_ms = 0;
};

class FakeMeshService : public v1::MeshService::Service {
 public:
  FakeBehaviour* behaviour;
  std::mutex mutex;
  std::map<std::string, v1::Mesh> meshes;
  v1::UploadHeader last_header;
  std::string last_upload;
  int cancelled_uploads = 0;
  v1::RebuildMeshRequest last_rebuild;

  v1::Mesh* Find(const std::string& key) {
    for (auto& [id, mesh] : meshes) {
      if (id == key) return &mesh;
      for (const std::string& name : mesh.names()) {
        if (name == key) return &mesh;
      }
    }
    return nullptr;
  }

  static grpc::Status Lost() { return grpc::Status(grpc::StatusCode::UNAVAILABLE, "lost"); }

  static grpc::Status NotFound(const std::string& key) {
    return grpc::Status(grpc::StatusCode::NOT_FOUND, "no such mesh: " + key);
  }

  grpc::Status UploadMesh(grpc::ServerContext* context, grpc::ServerReader<v1::UploadMeshRequest>* reader,
                          v1::UploadMeshResponse* response) override {
    v1::UploadMeshRequest request;
    reader->Read(&request);
    const v1::UploadHeader header = request.header();
    if (!behaviour->upload_status.ok() && behaviour->upload_failures-- > 0) return behaviour->upload_status;
    std::string bytes;
    while (reader->Read(&request)) bytes += request.chunk();
    const std::lock_guard lock(mutex);
    if (context->IsCancelled()) {
      ++cancelled_uploads;
      return grpc::Status::CANCELLED;
    }
    last_header = header;
    last_upload = bytes;
    v1::Mesh mesh;
    mesh.set_id(std::string(63, 'a') + std::to_string(meshes.size()));
    if (!header.name().empty()) mesh.add_names(header.name());
    mesh.set_triangle_count(1234567);
    mesh.mutable_bounds()->mutable_min()->set_x(-1);
    mesh.mutable_bounds()->mutable_min()->set_y(-1);
    mesh.mutable_bounds()->mutable_max()->set_x(1);
    mesh.mutable_bounds()->mutable_max()->set_y(1);
    mesh.set_state(v1::MESH_STATE_BUILDING);
    mesh.add_warnings("a face was \033[31mred");
    meshes[mesh.id()] = mesh;
    *response->mutable_mesh() = mesh;
    response->set_created(true);
    return grpc::Status::OK;
  }

  grpc::Status GetMesh(grpc::ServerContext*, const v1::GetMeshRequest* request,
                       v1::GetMeshResponse* response) override {
    const std::lock_guard lock(mutex);
    const v1::Mesh* mesh = Find(request->mesh());
    if (mesh == nullptr) return NotFound(request->mesh());
    *response->mutable_mesh() = *mesh;
    return grpc::Status::OK;
  }

  // Two meshes a page, whatever was asked for; the token is the id of the last one sent.
  grpc::Status ListMeshes(grpc::ServerContext*, const v1::ListMeshesRequest* request,
                          v1::ListMeshesResponse* response) override {
    std::this_thread::sleep_for(std::chrono::milliseconds(behaviour->list_delay_ms));
    const std::lock_guard lock(mutex);
    if (behaviour->list_failures-- > 0) return Lost();
    auto it = request->page_token().empty() ? meshes.begin() : meshes.upper_bound(request->page_token());
    for (; it != meshes.end() && response->meshes_size() < 2; ++it) *response->add_meshes() = it->second;
    if (it != meshes.end()) response->set_next_page_token(response->meshes(1).id());
    return grpc::Status::OK;
  }

  grpc::Status NameMesh(grpc::ServerContext*, const v1::NameMeshRequest* request,
                        v1::NameMeshResponse* response) override {
    const std::lock_guard lock(mutex);
    v1::Mesh* target = request->mesh().empty() ? nullptr : Find(request->mesh());
    if (!request->mesh().empty() && target == nullptr) return NotFound(request->mesh());
    if (v1::Mesh* previous = Find(request->name())) {
      response->set_previous_id(previous->id());
      previous->clear_names();
    }
    if (target != nullptr) target->add_names(request->name());
    return grpc::Status::OK;
  }

  grpc::Status DeleteMesh(grpc::ServerContext*, const v1::DeleteMeshRequest* request,
                          v1::DeleteMeshResponse* response) override {
    const std::lock_guard lock(mutex);
    if (behaviour->delete_failures-- > 0) return Lost();
    const v1::Mesh* mesh = Find(request->mesh());
    if (mesh == nullptr) return NotFound(request->mesh());
    response->set_id(mesh->id());
    meshes.erase(response->id());
    return grpc::Status::OK;
  }

  grpc::Status RebuildMesh(grpc::ServerContext*, const v1::RebuildMeshRequest* request,
                           v1::RebuildMeshResponse* response) override {
    const std::lock_guard lock(mutex);
    const v1::Mesh* mesh = Find(request->mesh());
    if (mesh == nullptr) return NotFound(request->mesh());
    last_rebuild = *request;
    *response->mutable_mesh() = *mesh;
    return grpc::Status::OK;
  }

  grpc::Status WatchBuild(grpc::ServerContext*, const v1::WatchBuildRequest* request,
                          grpc::ServerWriter<v1::WatchBuildResponse>* writer) override {
    {
      const std::lock_guard lock(mutex);
      if (Find(request->mesh()) == nullptr) return NotFound(request->mesh());
    }
    v1::WatchBuildResponse response;
    response.set_id(request->mesh());
    v1::BuildProgress& progress = *response.mutable_progress();
    progress.set_build_number(3);
    progress.set_triangles(1000);
    progress.set_state(v1::MESH_STATE_BUILDING);
    progress.set_phase(v1::BUILD_PHASE_TOP);
    progress.set_references_placed(500);
    writer->Write(response);
    if (behaviour->watch_failures-- > 0) return Lost();
    progress.set_state(v1::MESH_STATE_PROVISIONAL);
    progress.set_phase(v1::BUILD_PHASE_DELTA_LEAVES);
    progress.set_delta_leaves(40);
    progress.set_delta_leaves_built(10);
    writer->Write(response);
    progress.set_state(behaviour->final_state);
    progress.set_phase(v1::BUILD_PHASE_DONE);
    progress.set_delta_leaves_built(40);
    if (behaviour->final_state == v1::MESH_STATE_FAILED) progress.set_failure("out of memory");
    writer->Write(response);
    return grpc::Status::OK;
  }

  grpc::Status GetBuildStats(grpc::ServerContext*, const v1::GetBuildStatsRequest* request,
                             v1::GetBuildStatsResponse* response) override {
    const std::lock_guard lock(mutex);
    const v1::Mesh* mesh = Find(request->mesh());
    if (mesh == nullptr) return NotFound(request->mesh());
    if (mesh->names_size() > 0 && mesh->names(0) == "unbuilt") {
      return grpc::Status(grpc::StatusCode::FAILED_PRECONDITION, "no tree was built yet");
    }
    response->set_id(mesh->id());
    v1::BuildStats& stats = *response->mutable_stats();
    stats.mutable_options()->set_delta(32);
    stats.set_triangles(1000);
    stats.set_references(1100);
    stats.set_sah_cost(12.5);
    stats.set_provisional_seconds(0.125);
    v1::PhaseTime& phase = *stats.add_phases();
    phase.set_phase(v1::BUILD_PHASE_TOP);
    phase.set_wall_seconds(0.25);
    stats.add_delta_leaf_size_histogram(3);
    stats.add_delta_leaf_size_histogram(4321);
    stats.add_choices("eager: why not");
    return grpc::Status::OK;
  }
};

class FakeRayService : public v1::RayService::Service {
 public:
  FakeBehaviour* behaviour;
  std::mutex mutex;
  std::vector<v1::StreamStart> starts;  // of all streams
  std::multimap<std::string, std::string> last_metadata;
  v1::StreamStart last_start;
  std::vector<size_t> last_batch_bytes;
  std::string last_excluded;
  v1::CompareAccuracyRequest last_comparison;

  grpc::Status CastRays(grpc::ServerContext*, const v1::CastRaysRequest* request,
                        v1::CastRaysResponse* response) override {
    const std::lock_guard lock(mutex);
    last_start.set_mesh(request->mesh());
    *last_start.mutable_query() = request->query();
    Answer(request->rays(), response->mutable_hits());
    return grpc::Status::OK;
  }

  // Made up: FAST takes 100 ns and is wrong 3 times, WATERTIGHT 150 ns and once, EXACT 180 ns.
  grpc::Status CompareAccuracy(grpc::ServerContext*, const v1::CompareAccuracyRequest* request,
                               v1::CompareAccuracyResponse* response) override {
    const std::lock_guard lock(mutex);
    last_comparison = *request;
    last_start.clear_query();
    *last_start.mutable_query() = request->query();
    response->set_mesh_id(request->mesh());
    response->set_ray_count(request->rays().rays().size() / RayBytes());
    response->set_hit_count(response->ray_count() / 2);
    response->set_node_bytes(3 << 20);
    for (const auto level : {v1::ACCURACY_LEVEL_FAST, v1::ACCURACY_LEVEL_WATERTIGHT, v1::ACCURACY_LEVEL_EXACT}) {
      v1::AccuracyMeasurement* measurement = response->add_levels();
      measurement->set_accuracy(level);
      measurement->set_answered_accuracy(level);
    }
    response->mutable_levels(0)->set_nanoseconds_per_ray(100);
    response->mutable_levels(0)->set_false_misses(2);
    response->mutable_levels(0)->set_false_hits(1);
    response->mutable_levels(0)->set_t_error_ulp_max(12345);
    response->mutable_levels(1)->set_nanoseconds_per_ray(150);
    response->mutable_levels(1)->set_wrong_primitives(1);
    response->mutable_levels(2)->set_nanoseconds_per_ray(180);
    return grpc::Status::OK;
  }

  grpc::Status StreamRays(grpc::ServerContext* context,
                          grpc::ServerReaderWriter<v1::StreamRaysResponse, v1::StreamRaysRequest>* stream) override {
    v1::StreamRaysRequest request;
    if (!stream->Read(&request) || !request.has_start()) {
      return grpc::Status(grpc::StatusCode::INVALID_ARGUMENT, "start is missing");
    }
    const std::lock_guard lock(mutex);
    last_start = request.start();
    starts.push_back(last_start);
    last_metadata.clear();
    for (const auto& [key, value] : context->client_metadata()) {
      last_metadata.emplace(std::string(key.data(), key.size()), std::string(value.data(), value.size()));
    }
    const bool moved = starts.size() > 1 && !behaviour->moved_mesh.empty();
    last_batch_bytes.clear();
    last_excluded.clear();
    if (last_start.mesh() == "missing") return FakeMeshService::NotFound("missing");
    uint64_t batches = 0;
    grpc::Status status;
    while (true) {
      if (batches == behaviour->fail_at_batch && behaviour->stream_failures-- > 0) {
        status = behaviour->stream_status;
        break;
      }
      if (!stream->Read(&request)) break;
      last_batch_bytes.push_back(request.rays().rays().size());
      last_excluded += request.rays().excluded_primitive_ids();
      v1::StreamRaysResponse response;
      response.set_batch_number(behaviour->first_batch_number + batches);
      response.set_mesh_id(moved ? behaviour->moved_mesh : IdOf(last_start.mesh()));
      Answer(request.rays(), response.mutable_hits());
      ++batches;
      stream->Write(response);
    }
    context->AddTrailingMetadata("deltaray-batches", std::to_string(batches + behaviour->extra_batches));
    return status;
  }

 private:
  static std::string IdOf(const std::string& mesh) { return mesh.rfind("id of ", 0) == 0 ? mesh : "id of " + mesh; }

  template <typename T>
  static void Append(std::string* bytes, T value) {
    bytes->append(reinterpret_cast<const char*>(&value), sizeof(value));
  }

  // The coordinate `index` of ray `ray`, in any of the layouts.
  double Coordinate(const std::string& rays, size_t ray, size_t index) const {
    const v1::RayLayout layout = last_start.query().layout();
    const size_t columns = layout == v1::RAY_LAYOUT_FLOAT32X8 || layout == v1::RAY_LAYOUT_FLOAT64X8 ? 8 : 6;
    if (layout == v1::RAY_LAYOUT_FLOAT64X6 || layout == v1::RAY_LAYOUT_FLOAT64X8) {
      double value;
      std::memcpy(&value, rays.data() + (ray * columns + index) * sizeof(value), sizeof(value));
      return value;
    }
    float value;
    std::memcpy(&value, rays.data() + (ray * columns + index) * sizeof(value), sizeof(value));
    return value;
  }

  size_t RayBytes() const {
    switch (last_start.query().layout()) {
      case v1::RAY_LAYOUT_FLOAT32X8:
        return 32;
      case v1::RAY_LAYOUT_FLOAT64X6:
        return 48;
      case v1::RAY_LAYOUT_FLOAT64X8:
        return 64;
      default:
        return 24;
    }
  }

  void Answer(const v1::RayBatch& batch, v1::HitBatch* hits) const {
    const size_t count = batch.rays().size() / RayBytes();
    hits->set_ray_count(count);
    const v1::QueryKind kind = last_start.query().kind();
    uint32_t rows = 0;
    if (kind == v1::QUERY_KIND_ALL_HITS) Append(hits->mutable_offsets(), rows);
    for (size_t i = 0; i < count; ++i) {
      const double t = -Coordinate(batch.rays(), i, 2) / Coordinate(batch.rays(), i, 5);
      const bool hit = std::isfinite(t) && t >= 0;
      if (kind == v1::QUERY_KIND_COUNT_HITS) {
        Append<uint32_t>(hits->mutable_count(), hit);
        continue;
      }
      if (kind == v1::QUERY_KIND_ALL_HITS) {
        rows += hit;
        Append(hits->mutable_offsets(), rows);
        if (!hit) continue;
      }
      AppendRow(hit, static_cast<float>(t), hits);
    }
  }

  void AppendRow(bool hit, float t, v1::HitBatch* hits) const {
    for (const int column : last_start.query().columns()) {
      switch (column) {
        case v1::HIT_COLUMN_T:
          Append<float>(hits->mutable_t(), hit ? t : std::numeric_limits<float>::infinity());
          break;
        case v1::HIT_COLUMN_PRIMITIVE_ID:
          Append<uint32_t>(hits->mutable_primitive_id(), hit ? 7 : 0xFFFFFFFF);
          break;
        case v1::HIT_COLUMN_FACE_ID:
          Append<uint32_t>(hits->mutable_face_id(), hit ? 5 : 0xFFFFFFFF);
          break;
        case v1::HIT_COLUMN_GROUP_ID:
          Append<uint32_t>(hits->mutable_group_id(), 0xFFFFFFFF);
          break;
        case v1::HIT_COLUMN_UV:
          Append<float>(hits->mutable_uv(), hit ? 0.25f : 0);
          Append<float>(hits->mutable_uv(), hit ? 0.1f : 0);
          break;
        case v1::HIT_COLUMN_NORMAL:
          Append<float>(hits->mutable_normal(), 0);
          Append<float>(hits->mutable_normal(), 0);
          Append<float>(hits->mutable_normal(), hit ? 1 : 0);
          break;
        case v1::HIT_COLUMN_FLAGS:
          Append<uint8_t>(hits->mutable_flags(), hit ? 1 : 0);
          break;
        default:
          break;
      }
    }
  }
};

class FakeHealthService : public grpc::health::v1::Health::Service {
 public:
  FakeBehaviour* behaviour;

  grpc::Status Check(grpc::ServerContext*, const grpc::health::v1::HealthCheckRequest*,
                     grpc::health::v1::HealthCheckResponse* response) override {
    if (behaviour->health_failures-- > 0) return FakeMeshService::Lost();
    response->set_status(grpc::health::v1::HealthCheckResponse::SERVING);
    return grpc::Status::OK;
  }
};

// Listens on a free loopback port from construction to destruction.
class FakeServer {
 public:
  FakeServer() {
    mesh_service.behaviour = &behaviour;
    ray_service.behaviour = &behaviour;
    health_service.behaviour = &behaviour;
    int port = 0;
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
    builder.RegisterService(&mesh_service);
    builder.RegisterService(&ray_service);
    builder.RegisterService(&health_service);
    builder.SetMaxReceiveMessageSize(64 << 20);
    server_ = builder.BuildAndStart();
    address_ = "127.0.0.1:" + std::to_string(port);
  }

  ~FakeServer() { Stop(); }

  // From here on nobody listens.
  void Stop() { server_->Shutdown(); }

  const std::string& address() const { return address_; }

  FakeBehaviour behaviour;
  FakeMeshService mesh_service;
  FakeRayService ray_service;
  FakeHealthService health_service;

 private:
  std::unique_ptr<grpc::Server> server_;
  std::string address_;
};

}  // namespace deltaray

#endif  // TESTS_UNIT_CLIENT_FAKE_SERVER_H_
