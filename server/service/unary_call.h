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
#include "server/service/batch_budget.h"
#include "server/service/call_reactor.h"
#include "server/service/message_bytes.h"
#include "server/service/worker_pool.h"

namespace deltaray {

// A unary call that is finished by Reply or ReplyInTurn, from any thread. It has a share of a budget until its client
// has taken the reply.
class UnaryCall final : public CallReactor<grpc::ServerUnaryReactor> {
 public:
  // `response` belongs to gRPC and lives as long as the call is not finished; the others outlive the call.
  static std::shared_ptr<UnaryCall> Make(Calls* calls, grpc::ByteBuffer* response, BatchBudget* budget);
  UnaryCall(Calls* calls, grpc::ByteBuffer* response, BatchBudget* budget)
      : CallReactor(calls), response_(response), share_(budget) {}

  // BatchBudget::Share::Begin, where those that wait may be too many.
  BatchBudget::Answer Begin(uint64_t message_bytes, uint64_t bytes, std::function<void()> granted);

  // Finishes the call with `reply`, or where `status` is not OK with that. What Begin got is given back but for the
  // reply and the message, which gRPC keeps to the call's end.
  void Reply(const absl::Status& status, grpc::ByteBuffer reply);
  // Reply(OK, reply), once there is room for it. REQUIRES: Begin was not called.
  void ReplyInTurn(const grpc::ByteBuffer& reply);

  using CallReactor::Admit;

 private:
  void BeforeFinish() override { share_.Withdraw(); }

  grpc::ByteBuffer* const response_;
  BatchBudget::Share share_;
  uint64_t message_bytes_ = 0;  // of Begin
  std::weak_ptr<UnaryCall> weak_self_;
};

// What AnswerUnary needs; all of it outlives every call.
struct UnaryBackend {
  Calls* calls;
  BatchBudget* budget;       // of which replies take, until they are taken
  uint64_t max_reply_bytes;  // what is more becomes RESOURCE_EXHAUSTED
};

// Answers one call by handler(request), run on `pool`, or at once where that is nullptr and the handler does not block;
// not at all where nobody waits for it any more. The request holds neither rays nor files: one that is not small is
// refused before it is queued, since gRPC keeps it until its call is answered.
template <typename Request, typename Response>
grpc::ServerUnaryReactor* AnswerUnary(const UnaryBackend& backend, const RpcInfo& rpc, WorkerPool* pool,
                                      const grpc::ByteBuffer* request, grpc::ByteBuffer* response,
                                      std::function<absl::StatusOr<Response>(const Request&)> handler) {
  auto call = UnaryCall::Make(backend.calls, response, backend.budget);
  if (!UnaryCall::Admit(call, rpc)) return call.get();
  if (absl::Status small = CheckSmall(request->Length(), Request::descriptor()->full_name()); !small.ok()) {
    call->Reply(small, {});
    return call.get();
  }
  auto answer = [call, max_bytes = backend.max_reply_bytes, bytes = *request, handler = std::move(handler)] {
    const LogScope scope(call->record().request_id);
    const absl::Status status = CatchExceptions([&]() -> absl::Status {
      grpc::ByteBuffer reply;
      {
        Request message;
        if (absl::Status status = ParseMessage(bytes, &message); !status.ok()) return status;
        const absl::StatusOr<Response> answer = handler(message);
        if (!answer.ok()) return answer.status();
        absl::StatusOr<grpc::ByteBuffer> serialized = SerializeReply(*answer, max_bytes);
        if (!serialized.ok()) return serialized.status();
        reply.Swap(&*serialized);
      }
      call->ReplyInTurn(reply);
      return absl::OkStatus();
    });
    if (!status.ok()) call->Reply(status, {});
  };
  if (pool == nullptr) {
    answer();
  } else {
    pool->Run(std::move(answer), [call] { return call->cancelled(); });
  }
  return call.get();
}

}  // namespace deltaray

#endif  // SERVER_SERVICE_UNARY_CALL_H_
