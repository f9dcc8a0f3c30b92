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

// What CompareAccuracy keeps of each ray: errors of t, at three levels, in vectors that grow.
constexpr uint64_t kComparisonBytesPerRay = 3 * 2 * 2 * sizeof(uint32_t);
// A request of more bytes is parsed on a thread of the tracer.
constexpr size_t kSmallRequestBytes = 20'000;

// Whether the call, of a message of `message_bytes`, may take `bytes` now. False: `answer` will run on the tracer once
// it may. RESOURCE_EXHAUSTED: too many wait already.
absl::StatusOr<bool> MayBegin(UnaryCall& call, uint64_t message_bytes, uint64_t bytes, Tracer* tracer,
                              std::function<void()> answer) {
  switch (call.Begin(message_bytes, bytes, [tracer, answer = std::move(answer)] { tracer->Enqueue(answer); })) {
    case BatchBudget::Answer::kNow:
      return true;
    case BatchBudget::Answer::kLater:
      return false;
    case BatchBudget::Answer::kNever:
      break;
  }
  return absl::ResourceExhaustedError(
      "the memory for batches is in use (--batch-bytes); retry later with back-off, or use StreamRays, which waits");
}

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
                           std::shared_ptr<BatchMeter> meter) {
  const uint64_t message_bytes = bytes.Length();
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
  const absl::StatusOr<bool> now =
      MayBegin(*call, message_bytes, message_bytes + MaxAnswerBytes(*query, job->rays.rays.size, backend.limits),
               backend.tracer, [backend, job] { RunBatch(backend, job); });
  if (!now.ok() || !*now) return now.status();
  // A task of its own, also on the tracer: how long it takes is known only now.
  job->expected = ExpectedOf(*query, job->rays.rays.size);
  RunWhereExpected(*backend.tracer, job->expected, [backend, job] { RunBatch(backend, job); });
  return absl::OkStatus();
}

// The rest of a CompareAccuracy call, on a thread of the tracer.
void CompareOn(const MeshStore::Answer& tree, const RayBackend& backend, const ComparisonQuery& comparison,
               const RayBatchBytes& rays, UnaryCall& call) {
  grpc::ByteBuffer reply;
  const absl::Status status = CatchExceptions([&] {
    const BatchControl control{[&] { return call.cancelled(); }, [&] { backend.tracer->RunShort(); }};
    absl::StatusOr<v1::CompareAccuracyResponse> response =
        CompareAccuracy(*tree.snapshot, comparison, rays, backend.limits.max_rays, control);
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
  const uint64_t message_bytes = bytes.Length();
  v1::CompareAccuracyRequest request;
  const auto rays = std::make_shared<RayBatchBytes>();
  if (absl::Status status = ParseRayMessage(std::move(bytes), &request, rays.get()); !status.ok()) return status;
  const absl::StatusOr<ComparisonQuery> comparison = ReadComparison(request);
  if (!comparison.ok()) return comparison.status();
  const auto compare = [backend, call, rays, mesh = request.mesh(), comparison = *comparison] {
    UseTree(
        backend, mesh, comparison.query.wait_final, [call] { return call->cancelled(); },
        [backend, call, rays, comparison](absl::StatusOr<MeshStore::Answer> tree, bool) {
          if (tree.ok()) {
            CompareOn(*tree, backend, comparison, *rays, *call);
          } else {
            call->Reply(tree.status(), {});
          }
        });
  };
  const uint64_t errors_bytes = rays->rays.size / comparison->query.RayBytes() * kComparisonBytesPerRay;
  const absl::StatusOr<bool> now =
      MayBegin(*call, message_bytes, message_bytes + errors_bytes, backend.tracer, compare);
  if (!now.ok()) return now.status();
  if (*now) compare();
  return absl::OkStatus();
}

}  // namespace

grpc::ServerUnaryReactor* RayHandlers::CastRays(grpc::CallbackServerContext* context, const grpc::ByteBuffer* request,
                                                grpc::ByteBuffer* response) {
  auto call = UnaryCall::Make(calls_, response, backend_.budget);
  if (!UnaryCall::Admit(call, {"RayService/CastRays", context})) return call.get();
  const bool on_tracer = request->Length() > kSmallRequestBytes;
  auto answer = [backend = backend_, call, bytes = *request,
                 meter = std::make_shared<BatchMeter>(backend_.metrics, &call->record())] {
    const absl::Status status = CatchExceptions([&] { return AnswerRequest(backend, call, bytes, meter); });
    if (!status.ok()) call->Reply(status, {});
  };
  if (on_tracer) {
    backend_.tracer->EnqueueShort(std::move(answer));
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
  auto call = UnaryCall::Make(calls_, response, backend_.budget);
  if (!UnaryCall::Admit(call, {"RayService/CompareAccuracy", context})) return call.get();
  backend_.tracer->Enqueue([backend = backend_, call, bytes = *request] {
    const absl::Status status = CatchExceptions([&] { return AnswerComparison(backend, call, bytes); });
    if (!status.ok()) call->Reply(status, {});
  });
  return call.get();
}

}  // namespace deltaray
