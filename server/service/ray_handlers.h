// The RPCs of RayService.

#ifndef SERVER_SERVICE_RAY_HANDLERS_H_
#define SERVER_SERVICE_RAY_HANDLERS_H_

#include "deltaray/v1/ray_service.grpc.pb.h"
#include "server/service/batch_job.h"
#include "server/service/calls.h"

namespace deltaray {

// Thread-safe.
class RayHandlers final
    : public v1::RayService::WithRawCallbackMethod_CastRays<v1::RayService::WithRawCallbackMethod_StreamRays<
          v1::RayService::WithRawCallbackMethod_CompareAccuracy<v1::RayService::Service>>> {
 public:
  // `calls` outlives the handlers.
  RayHandlers(Calls* calls, const RayBackend& backend) : calls_(calls), backend_(backend) {}

  grpc::ServerUnaryReactor* CastRays(grpc::CallbackServerContext* context, const grpc::ByteBuffer* request,
                                     grpc::ByteBuffer* response) override;
  grpc::ServerBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer>* StreamRays(
      grpc::CallbackServerContext* context) override;
  grpc::ServerUnaryReactor* CompareAccuracy(grpc::CallbackServerContext* context, const grpc::ByteBuffer* request,
                                            grpc::ByteBuffer* response) override;

 private:
  Calls* const calls_;
  const RayBackend backend_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_RAY_HANDLERS_H_
