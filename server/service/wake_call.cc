#include "server/service/wake_call.h"

#include <utility>

#include "grpcpp/client_context.h"
#include "grpcpp/generic/generic_stub.h"
#include "grpcpp/support/byte_buffer.h"

namespace deltaray {

void WakeCall::Make() {
  if (*under_way_) return;
  began_ = std::chrono::steady_clock::now();
  *under_way_ = true;
  struct Call {
    grpc::ClientContext context;
    grpc::ByteBuffer request, response;
  };
  auto call = std::make_shared<Call>();
  // An empty HealthCheckRequest.
  grpc::Slice empty;
  call->request = grpc::ByteBuffer(&empty, 1);
  grpc::GenericStub(channel_).UnaryCall(&call->context, "/grpc.health.v1.Health/Check", {}, &call->request,
                                        &call->response,
                                        [call, under_way = under_way_](const grpc::Status&) { *under_way = false; });
}

std::chrono::milliseconds WakeCall::Waiting() const {
  if (!*under_way_) return {};
  return std::chrono::duration_cast<std::chrono::milliseconds>(std::chrono::steady_clock::now() - began_.load());
}

}  // namespace deltaray
