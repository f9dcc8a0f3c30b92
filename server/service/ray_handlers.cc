#include "server/service/ray_handlers.h"

#include <memory>
#include <utility>

#include "server/service/accuracy_comparison.h"
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
                           std::shared_ptr<BatchMeter> meter, bool on_tracer) {
  v1::CastRaysRequest request;
  auto job = std::make_shared<BatchJob>();
  if (absl::Status status = ParseRayMessage(std::move(bytes), &request, &job->rays); !status.ok()) return status;
  absl::StatusOr<BatchQuery> query = ReadQuery(request.query());
  if (!query.ok()) return query.status();
  job->mesh = request.mesh();
  job->query = *query;
  job->meter = std::move(meter);
  job->cancelled = [call] { return call->cancelled(); };
  job->done = [call](absl::StatusOr<BatchJob::Answer> answer) { ReplyTo(*call, std::move(answer)); };
  if (on_tracer || IsSmall(*query, job->rays.rays.size)) {
    RunBatch(backend, std::move(job));
  } else {
    backend.tracer->Enqueue([backend, job = std::move(job)] { RunBatch(backend, job); });
  }
  return absl::OkStatus();
}

// The rest of a CompareAccuracy call, on a thread of the tracer.
void CompareOn(const MeshStore::Answer& tree, const RayBackend& backend, const ComparisonQuery& comparison,
               const RayBatchBytes& rays, UnaryCall& call) {
  grpc::ByteBuffer reply;
  const absl::Status status = CatchExceptions([&] {
    absl::StatusOr<v1::CompareAccuracyResponse> response = CompareAccuracy(
        *tree.snapshot, comparison, rays, backend.limits.max_rays, [&call] { return call.cancelled(); });
    if (!response.ok()) return response.status();
    backend.store->NoteAnswer(tree);
    response->set_mesh_id(tree.id);
    reply = SerializeMessage(*response);
    return absl::OkStatus();
  });
  call.Reply(status, std::move(reply));
}

absl::Status AnswerComparison(const RayBackend& backend, const std::shared_ptr<UnaryCall>& call,
                              grpc::ByteBuffer bytes) {
  v1::CompareAccuracyRequest request;
  const auto rays = std::make_shared<RayBatchBytes>();
  if (absl::Status status = ParseRayMessage(std::move(bytes), &request, rays.get()); !status.ok()) return status;
  const absl::StatusOr<ComparisonQuery> comparison = ReadComparison(request);
  if (!comparison.ok()) return comparison.status();
  UseTree(backend, request.mesh(), comparison->query.wait_final,
          [backend, call, rays, comparison = *comparison](absl::StatusOr<MeshStore::Answer> tree) {
            if (tree.ok()) {
              CompareOn(*tree, backend, comparison, *rays, *call);
            } else {
              call->Reply(tree.status(), {});
            }
          });
  return absl::OkStatus();
}

}  // namespace

grpc::ServerUnaryReactor* RayHandlers::CastRays(grpc::CallbackServerContext* context, const grpc::ByteBuffer* request,
                                                grpc::ByteBuffer* response) {
  auto call = std::make_shared<UnaryCall>(calls_, response);
  if (!UnaryCall::Admit(call, {"RayService/CastRays", context})) return call.get();
  const bool on_tracer = request->Length() > kSmallRequestBytes;
  auto answer = [backend = backend_, call, bytes = *request,
                 meter = std::make_shared<BatchMeter>(backend_.metrics, &call->record()), on_tracer] {
    const absl::Status status = CatchExceptions([&] { return AnswerRequest(backend, call, bytes, meter, on_tracer); });
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
  return StreamCall::Start(calls_, {"RayService/StreamRays", context}, backend_);
}

grpc::ServerUnaryReactor* RayHandlers::CompareAccuracy(grpc::CallbackServerContext* context,
                                                       const grpc::ByteBuffer* request, grpc::ByteBuffer* response) {
  auto call = std::make_shared<UnaryCall>(calls_, response);
  if (!UnaryCall::Admit(call, {"RayService/CompareAccuracy", context})) return call.get();
  backend_.tracer->Enqueue([backend = backend_, call, bytes = *request] {
    const absl::Status status = CatchExceptions([&] { return AnswerComparison(backend, call, bytes); });
    if (!status.ok()) call->Reply(status, {});
  });
  return call.get();
}

}  // namespace deltaray
