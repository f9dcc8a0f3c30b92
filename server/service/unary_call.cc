#include "server/service/unary_call.h"

namespace deltaray {

std::shared_ptr<UnaryCall> UnaryCall::Make(Calls* calls, grpc::ByteBuffer* response, BatchBudget* budget) {
  auto call = std::make_shared<UnaryCall>(calls, response, budget);
  call->weak_self_ = call;
  return call;
}

BatchBudget::Answer UnaryCall::Begin(uint64_t message_bytes, uint64_t bytes, std::function<void()> granted) {
  message_bytes_ = message_bytes;
  return share_.Begin(message_bytes, bytes, /*may_refuse=*/true, std::move(granted));
}

void UnaryCall::Reply(const absl::Status& status, grpc::ByteBuffer reply) {
  share_.Reply(message_bytes_ + reply.Length(), CutOffLater(weak_self_, ReplyLostError()));
  MutexLock lock(mutex_);
  if (finished_) return;
  response_->Swap(&reply);
  FinishOnce(status);
}

void UnaryCall::ReplyInTurn(const grpc::ByteBuffer& reply) {
  const uint64_t bytes = reply.Length();
  // What waits is there already, and counts.
  const BatchBudget::Answer answer = share_.Begin(bytes, bytes, /*may_refuse=*/true, [weak_self = weak_self_, reply] {
    if (const auto self = weak_self.lock()) self->Reply(absl::OkStatus(), reply);
  });
  if (answer == BatchBudget::Answer::kNow) Reply(absl::OkStatus(), reply);
  if (answer == BatchBudget::Answer::kNever) {
    Reply(
        absl::ResourceExhaustedError(
            "the call was carried out, but there is no room for its reply (--batch-bytes); retry later with back-off"),
        {});
  }
}

}  // namespace deltaray
