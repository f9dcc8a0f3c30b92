#include "server/service/ray_handlers.h"

#include <memory>
#include <utility>

#include "server/service/message_bytes.h"
#include "server/service/ray_message.h"
#include "server/service/rpc_status.h"
#include "server/service/stream_call.h"
#include "server/service/unary_call.h"

namespace deltaray {
namespace {

// A request of more bytes is parsed on a thread of the tracer.
constexpr size_t kSmallRequestBytes = 20'000;

void ReplyTo(UnaryCall& call, absl::StatusOr<BatchJob::Answer> answer) {
  grpc::ByteBuffer reply;
  const absl::Status status = CatchExceptions([&] {
    if (!answer.ok()) return answer.status();
    v1::CastRaysResponse response;
    response.set_mesh_id(answer->mesh_id);
    reply = SerializeMessage(response, v1::CastRaysResponse::kHitsFieldNumber, std::move(answer->hits));
    return absl::OkStatus();
  });
  call.Reply(status, std::move(reply));
}

absl::Status AnswerRequest(const RayBackend& backend, const std::shared_ptr<UnaryCall>& call, grpc::ByteBuffer bytes,
                           bool on_tracer) {
  v1::CastRaysRequest request;
  auto job = std::make_shared<BatchJob>();
  if (absl::Status status = ParseRayMessage(std::move(bytes), &request, &job->rays); !status.ok()) return status;
  absl::StatusOr<BatchQuery> query = ReadQuery(request.query());
  if (!query.ok()) return query.status();
  job->mesh = request.mesh();
  job->query = *query;
  job->cancelled = [call] { return call->cancelled(); };
  job->done = [call](absl::StatusOr<BatchJob::Answer> answer) { ReplyTo(*call, std::move(answer)); };
  if (on_tracer || IsSmall(*query, job->rays.rays.size)) {
    RunBatch(backend, std::move(job));
  } else {
    backend.tracer->Enqueue([backend, job = std::move(job)] { RunBatch(backend, job); });
  }
  return absl::OkStatus();
}

}  // namespace

grpc::ServerUnaryReactor* RayHandlers::CastRays(grpc::CallbackServerContext*, const grpc::ByteBuffer* request,
                                                grpc::ByteBuffer* response) {
  auto call = std::make_shared<UnaryCall>(calls_, response);
  if (!UnaryCall::Admit(call)) return call.get();
  const bool on_tracer = request->Length() > kSmallRequestBytes;
  auto answer = [backend = backend_, call, bytes = *request, on_tracer] {
    const absl::Status status = CatchExceptions([&] { return AnswerRequest(backend, call, bytes, on_tracer); });
    if (!status.ok()) call->Reply(status, {});
  };
  if (on_tracer) {
    backend_.tracer->Enqueue(std::move(answer));
  } else {
    answer();
  }
  return call.get();
}

grpc::ServerBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer>* RayHandlers::StreamRays(
    grpc::CallbackServerContext* context) {
  return StreamCall::Start(calls_, backend_, context);
}

}  // namespace deltaray
