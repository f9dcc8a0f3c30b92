// The RPCs of MeshService.

#ifndef SERVER_SERVICE_MESH_HANDLERS_H_
#define SERVER_SERVICE_MESH_HANDLERS_H_

#include "deltaray/v1/mesh_service.grpc.pb.h"
#include "server/service/calls.h"
#include "server/service/unary_call.h"
#include "server/service/upload_call.h"

namespace deltaray {

// Thread-safe. What blocks on the disk runs on the pools of `backend`.
class MeshHandlers final
    : public v1::MeshService::WithRawCallbackMethod_UploadMesh<
          v1::MeshService::WithRawCallbackMethod_GetMesh<v1::MeshService::WithRawCallbackMethod_ListMeshes<
              v1::MeshService::WithRawCallbackMethod_NameMesh<v1::MeshService::WithRawCallbackMethod_DeleteMesh<
                  v1::MeshService::WithRawCallbackMethod_RebuildMesh<v1::MeshService::WithRawCallbackMethod_WatchBuild<
                      v1::MeshService::WithRawCallbackMethod_GetBuildStats<v1::MeshService::Service>>>>>>>> {
 public:
  // `calls` outlives the handlers.
  MeshHandlers(Calls* calls, const UploadBackend& backend)
      : calls_(calls), backend_(backend), unary_{calls, backend.budget, backend.max_message_bytes} {}

  grpc::ServerReadReactor<grpc::ByteBuffer>* UploadMesh(grpc::CallbackServerContext* context,
                                                        grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* GetMesh(grpc::CallbackServerContext* context, const grpc::ByteBuffer* request,
                                    grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* ListMeshes(grpc::CallbackServerContext* context, const grpc::ByteBuffer* request,
                                       grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* NameMesh(grpc::CallbackServerContext* context, const grpc::ByteBuffer* request,
                                     grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* DeleteMesh(grpc::CallbackServerContext* context, const grpc::ByteBuffer* request,
                                       grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* RebuildMesh(grpc::CallbackServerContext* context, const grpc::ByteBuffer* request,
                                        grpc::ByteBuffer* response) override;
  grpc::ServerWriteReactor<grpc::ByteBuffer>* WatchBuild(grpc::CallbackServerContext* context,
                                                         const grpc::ByteBuffer* request) override;
  grpc::ServerUnaryReactor* GetBuildStats(grpc::CallbackServerContext* context, const grpc::ByteBuffer* request,
                                          grpc::ByteBuffer* response) override;

 private:
  Calls* const calls_;
  const UploadBackend backend_;
  const UnaryBackend unary_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_MESH_HANDLERS_H_
