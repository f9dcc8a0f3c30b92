#include "server/service/mesh_handlers.h"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/service/mesh_messages.h"
#include "server/service/watch_call.h"
#include "server/store/mesh_name.h"

namespace deltaray {
namespace {

constexpr uint32_t kDefaultPageSize = 100;
constexpr uint32_t kMaxPageSize = 1000;
// Bytes of a page besides its meshes, and of a mesh's tag and length, at most.
constexpr uint64_t kPageOverheadBytes = 100;
constexpr uint64_t kMeshOverheadBytes = 11;

}  // namespace

grpc::ServerReadReactor<grpc::ByteBuffer>* MeshHandlers::UploadMesh(grpc::CallbackServerContext* context,
                                                                    grpc::ByteBuffer* response) {
  return UploadCall::Start(calls_, {"MeshService/UploadMesh", context}, backend_, response);
}

grpc::ServerUnaryReactor* MeshHandlers::GetMesh(grpc::CallbackServerContext* context, const grpc::ByteBuffer* request,
                                                grpc::ByteBuffer* response) {
  return AnswerUnary<v1::GetMeshRequest, v1::GetMeshResponse>(
      // The names of its groups may be read from the disk.
      unary_, {"MeshService/GetMesh", context}, backend_.disk, request, response,
      [store = backend_.store](const v1::GetMeshRequest& get) -> absl::StatusOr<v1::GetMeshResponse> {
        absl::StatusOr<MeshInfo> info = store->Get(get.mesh());
        if (!info.ok()) return info.status();
        v1::GetMeshResponse reply;
        *reply.mutable_mesh() = ToMessage(*info);
        return reply;
      });
}

grpc::ServerUnaryReactor* MeshHandlers::ListMeshes(grpc::CallbackServerContext* context,
                                                   const grpc::ByteBuffer* request, grpc::ByteBuffer* response) {
  return AnswerUnary<v1::ListMeshesRequest, v1::ListMeshesResponse>(
      unary_, {"MeshService/ListMeshes", context}, nullptr, request, response,
      [store = backend_.store, max_bytes = backend_.max_message_bytes](
          const v1::ListMeshesRequest& list) -> absl::StatusOr<v1::ListMeshesResponse> {
        // A token is the id of the last mesh of the page before.
        if (!list.page_token().empty() && !IsMeshId(list.page_token())) {
          return absl::InvalidArgumentError("page_token: not one that this service gave out");
        }
        const uint32_t size = list.page_size() == 0 ? kDefaultPageSize : std::min(list.page_size(), kMaxPageSize);
        // One more than asked for tells whether there is a next page.
        std::vector<MeshInfo> meshes = store->List(list.page_token(), size + 1);
        v1::ListMeshesResponse reply;
        // Meshes of many names may fill a page early.
        uint64_t bytes = kPageOverheadBytes;
        for (size_t i = 0; i < meshes.size(); ++i) {
          v1::Mesh mesh = ToMessage(meshes[i]);
          bytes += mesh.ByteSizeLong() + kMeshOverheadBytes;
          if (i == size || (i > 0 && bytes > max_bytes)) {
            reply.set_next_page_token(meshes[i - 1].id);
            break;
          }
          reply.add_meshes()->Swap(&mesh);
        }
        return reply;
      });
}

grpc::ServerUnaryReactor* MeshHandlers::NameMesh(grpc::CallbackServerContext* context, const grpc::ByteBuffer* request,
                                                 grpc::ByteBuffer* response) {
  return AnswerUnary<v1::NameMeshRequest, v1::NameMeshResponse>(
      unary_, {"MeshService/NameMesh", context}, backend_.changes, request, response,
      [store = backend_.store](const v1::NameMeshRequest& name) -> absl::StatusOr<v1::NameMeshResponse> {
        if (absl::Status status = ValidateMeshName(name.name()); !status.ok()) {
          return absl::Status(status.code(), absl::StrCat("name: ", status.message()));
        }
        absl::StatusOr<std::string> previous = store->Name(name.name(), name.mesh());
        if (!previous.ok()) return previous.status();
        v1::NameMeshResponse reply;
        reply.set_previous_id(*std::move(previous));
        return reply;
      });
}

grpc::ServerUnaryReactor* MeshHandlers::DeleteMesh(grpc::CallbackServerContext* context,
                                                   const grpc::ByteBuffer* request, grpc::ByteBuffer* response) {
  return AnswerUnary<v1::DeleteMeshRequest, v1::DeleteMeshResponse>(
      unary_, {"MeshService/DeleteMesh", context}, backend_.changes, request, response,
      [store = backend_.store](const v1::DeleteMeshRequest& mesh) -> absl::StatusOr<v1::DeleteMeshResponse> {
        absl::StatusOr<std::string> id = store->Delete(mesh.mesh());
        if (!id.ok()) return id.status();
        v1::DeleteMeshResponse reply;
        reply.set_id(*std::move(id));
        return reply;
      });
}

grpc::ServerUnaryReactor* MeshHandlers::RebuildMesh(grpc::CallbackServerContext* context,
                                                    const grpc::ByteBuffer* request, grpc::ByteBuffer* response) {
  return AnswerUnary<v1::RebuildMeshRequest, v1::RebuildMeshResponse>(
      unary_, {"MeshService/RebuildMesh", context}, backend_.changes, request, response,
      [store = backend_.store](const v1::RebuildMeshRequest& rebuild) -> absl::StatusOr<v1::RebuildMeshResponse> {
        absl::StatusOr<Config> config;
        if (rebuild.has_build_options()) {
          config = ReadBuildOptions(rebuild.build_options());
        } else if (absl::StatusOr<MeshInfo> info = store->Get(rebuild.mesh()); info.ok()) {
          config = info->config;
        } else {
          config = info.status();
        }
        if (!config.ok()) return config.status();
        absl::StatusOr<MeshInfo> info = store->Rebuild(rebuild.mesh(), *config);
        if (!info.ok()) return info.status();
        v1::RebuildMeshResponse reply;
        *reply.mutable_mesh() = ToMessage(*info);
        return reply;
      });
}

grpc::ServerWriteReactor<grpc::ByteBuffer>* MeshHandlers::WatchBuild(grpc::CallbackServerContext* context,
                                                                     const grpc::ByteBuffer* request) {
  return WatchCall::Start(calls_, {"MeshService/WatchBuild", context}, backend_.store, backend_.disk, request);
}

grpc::ServerUnaryReactor* MeshHandlers::GetBuildStats(grpc::CallbackServerContext* context,
                                                      const grpc::ByteBuffer* request, grpc::ByteBuffer* response) {
  return AnswerUnary<v1::GetBuildStatsRequest, v1::GetBuildStatsResponse>(
      // The statistics of a tree that is not final look at all of it.
      unary_, {"MeshService/GetBuildStats", context}, backend_.disk, request, response,
      [store = backend_.store](const v1::GetBuildStatsRequest& stats) -> absl::StatusOr<v1::GetBuildStatsResponse> {
        const absl::StatusOr<std::string> id = store->Resolve(stats.mesh());
        if (!id.ok()) return id.status();
        absl::StatusOr<StoredStatistics> statistics = store->Statistics(*id);
        if (!statistics.ok()) return statistics.status();
        v1::GetBuildStatsResponse reply;
        reply.set_id(*id);
        *reply.mutable_stats() = ToMessage(*statistics);
        return reply;
      });
}

}  // namespace deltaray
