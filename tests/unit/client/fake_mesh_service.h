// Meshes without geometry.

#ifndef TESTS_UNIT_CLIENT_FAKE_MESH_SERVICE_H_
#define TESTS_UNIT_CLIENT_FAKE_MESH_SERVICE_H_

#include <chrono>
#include <map>
#include <mutex>
#include <string>
#include <thread>

#include "deltaray/v1/mesh_service.grpc.pb.h"
#include "tests/unit/client/fake_behaviour.h"

namespace deltaray {

// What it saw is to be read after a call.
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
    if (behaviour->no_ids) mesh.clear_id();
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
    if (behaviour->list_failures-- > 0) return behaviour->lost;
    auto it = request->page_token().empty() ? meshes.begin() : meshes.upper_bound(request->page_token());
    for (; it != meshes.end() && response->meshes_size() < 2; ++it) *response->add_meshes() = it->second;
    if (it != meshes.end()) response->set_next_page_token(response->meshes(1).id());
    if (!behaviour->page_token.empty()) response->set_next_page_token(behaviour->page_token);
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
    if (behaviour->delete_failures-- > 0) return behaviour->lost;
    const v1::Mesh* mesh = Find(request->mesh());
    if (mesh == nullptr) return NotFound(request->mesh());
    response->set_id(mesh->id());
    meshes.erase(response->id());
    if (behaviour->no_ids) response->clear_id();
    return grpc::Status::OK;
  }

  grpc::Status RebuildMesh(grpc::ServerContext*, const v1::RebuildMeshRequest* request,
                           v1::RebuildMeshResponse* response) override {
    const std::lock_guard lock(mutex);
    const v1::Mesh* mesh = Find(request->mesh());
    if (mesh == nullptr) return NotFound(request->mesh());
    last_rebuild = *request;
    *response->mutable_mesh() = *mesh;
    if (behaviour->no_ids) response->mutable_mesh()->clear_id();
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
    if (behaviour->watch_failures-- > 0) return behaviour->lost;
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

}  // namespace deltaray

#endif  // TESTS_UNIT_CLIENT_FAKE_MESH_SERVICE_H_
