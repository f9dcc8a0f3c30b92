// Unary RPCs on raw bytes.

#ifndef SERVER_SERVICE_UNARY_CALL_H_
#define SERVER_SERVICE_UNARY_CALL_H_

#include <functional>
#include <memory>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "grpcpp/support/byte_buffer.h"
#include "grpcpp/support/server_callback.h"
#include "server/service/call_reactor.h"
#include "server/service/message_bytes.h"
#include "server/service/worker_pool.h"

namespace deltaray {

// A unary call that is finished by Reply, from any thread.
class UnaryCall : public CallReactor<grpc::ServerUnaryReactor> {
 public:
  // `response` belongs to gRPC and lives as long as the call is not finished.
  UnaryCall(Calls* calls, grpc::ByteBuffer* response) : CallReactor(calls), response_(response) {}

  // Finishes the call with `reply`, or where `status` is not OK with that.
  void Reply(const absl::Status& status, grpc::ByteBuffer reply) {
    MutexLock lock(mutex_);
    if (finished_) return;
    response_->Swap(&reply);
    FinishOnce(status);
  }

  using CallReactor::Admit;

 private:
  grpc::ByteBuffer* const response_;
};

// Answers one call by handler(request), run on `pool`, or at once where that is nullptr and the handler does not block.
// The request holds neither rays nor files, see ParseSmallMessage. A reply of more than max_reply_bytes becomes
// RESOURCE_EXHAUSTED.
template <typename Request, typename Response>
grpc::ServerUnaryReactor* AnswerUnary(Calls* calls, const RpcInfo& rpc, WorkerPool* pool, uint64_t max_reply_bytes,
                                      const grpc::ByteBuffer* request, grpc::ByteBuffer* response,
                                      std::function<absl::StatusOr<Response>(const Request&)> handler) {
  auto call = std::make_shared<UnaryCall>(calls, response);
  if (!UnaryCall::Admit(call, rpc)) return call.get();
  auto answer = [call, max_reply_bytes, bytes = *request, handler = std::move(handler)] {
    const LogScope scope(call->record().request_id);
    grpc::ByteBuffer reply;
    const absl::Status status = CatchExceptions([&]() -> absl::Status {
      Request message;
      if (absl::Status status = ParseSmallMessage(bytes, &message); !status.ok()) return status;
      const absl::StatusOr<Response> answer = handler(message);
      if (!answer.ok()) return answer.status();
      absl::StatusOr<grpc::ByteBuffer> bytes = SerializeReply(*answer, max_reply_bytes);
      if (bytes.ok()) reply.Swap(&*bytes);
      return bytes.status();
    });
    call->Reply(status, std::move(reply));
  };
  if (pool == nullptr) {
    answer();
  } else {
    pool->Run(std::move(answer));
  }
  return call.get();
}

}  // namespace deltaray

#endif  // SERVER_SERVICE_UNARY_CALL_H_
