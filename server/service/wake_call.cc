#include "server/service/wake_call.h"

#include "grpcpp/client_context.h"
#include "grpcpp/generic/generic_stub.h"
#include "grpcpp/support/byte_buffer.h"

namespace deltaray {

struct WakeCall::Call {
  // Destroyed last, when the context has let go of the channel.
  struct End {
    ~End() {
      if (state == nullptr) return;
      MutexLock lock(state->mutex);
      state->under_way = false;
      state->changed.notify_all();
    }
    std::shared_ptr<State> state;
  };

  End end;
  grpc::ClientContext context;
  grpc::ByteBuffer request, response;
};

WakeCall::~WakeCall() {
  std::shared_ptr<Call> call;
  {
    MutexLock lock(state_->mutex);
    call = state_->call.lock();
  }
  if (call != nullptr) call->context.TryCancel();
  call = nullptr;
  MutexLock lock(state_->mutex);
  while (state_->under_way) state_->changed.wait(state_->mutex);
}

void WakeCall::Make() {
  const auto call = std::make_shared<Call>();
  {
    MutexLock lock(state_->mutex);
    if (state_->under_way) return;
    state_->under_way = true;
    state_->began = std::chrono::steady_clock::now();
    state_->call = call;
    call->end.state = state_;
  }
  // An empty HealthCheckRequest.
  grpc::Slice empty;
  call->request = grpc::ByteBuffer(&empty, 1);
  grpc::GenericStub(channel_).UnaryCall(&call->context, "/grpc.health.v1.Health/Check", {}, &call->request,
                                        &call->response, [call](const grpc::Status&) {});
}

std::chrono::milliseconds WakeCall::Waiting() const {
  MutexLock lock(state_->mutex);
  if (!state_->under_way) return {};
  return std::chrono::duration_cast<std::chrono::milliseconds>(std::chrono::steady_clock::now() - state_->began);
}

}  // namespace deltaray
