#include "server/service/health.h"

#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "deltaray/v1/mesh_service.grpc.pb.h"
#include "deltaray/v1/ray_service.grpc.pb.h"
#include "server/mesh/location.h"
#include "server/service/health_watch.h"
#include "server/service/message_bytes.h"
#include "server/service/unary_call.h"

namespace deltaray {
namespace {

using grpc::health::v1::HealthCheckRequest;
using grpc::health::v1::HealthCheckResponse;

constexpr char kMeshPrefix[] = "mesh/";
constexpr uint64_t kReplyBytes = 64;  // far more than one takes

absl::StatusOr<HealthCheckResponse> Answer(Health::Status status, absl::string_view service) {
  if (status == HealthCheckResponse::SERVICE_UNKNOWN) {
    return absl::NotFoundError(absl::StrCat("no such service or mesh: ", Quoted(service)));
  }
  HealthCheckResponse response;
  response.set_status(status);
  return response;
}

}  // namespace

bool Health::IsMesh(absl::string_view service) { return absl::StartsWith(service, kMeshPrefix); }

Health::Status Health::Of(absl::string_view service) const {
  bool serves = true;
  if (absl::string_view mesh = service; absl::ConsumePrefix(&mesh, kMeshPrefix)) {
    const absl::StatusOr<BuildReport> report = store_->Watch(mesh, /*start=*/true);
    if (absl::IsNotFound(report.status())) return HealthCheckResponse::SERVICE_UNKNOWN;
    serves = report.ok() && report->answers;
  } else if (!service.empty() && service != v1::MeshService::service_full_name() &&
             service != v1::RayService::service_full_name()) {
    return HealthCheckResponse::SERVICE_UNKNOWN;
  }
  return serves && !draining_ ? HealthCheckResponse::SERVING : HealthCheckResponse::NOT_SERVING;
}

bool Health::FindBlocks(absl::string_view service) const {
  return absl::ConsumePrefix(&service, kMeshPrefix) && !store_->IsKnown(service);
}

Health::Status Health::Find(absl::string_view service) const {
  if (absl::string_view mesh = service; absl::ConsumePrefix(&mesh, kMeshPrefix)) {
    const absl::Status found = store_->Resolve(mesh).status();
    // It is there, but of no use.
    if (!found.ok() && !absl::IsNotFound(found)) return HealthCheckResponse::NOT_SERVING;
  }
  return Of(service);
}

grpc::ServerUnaryReactor* HealthHandlers::Check(grpc::CallbackServerContext* context, const grpc::ByteBuffer* request,
                                                grpc::ByteBuffer* response) {
  HealthCheckRequest message;
  const absl::Status parsed = ParseSmallMessage(*request, &message);
  if (parsed.ok() && Health::IsMesh(message.service())) {
    const bool on_disk = health_.FindBlocks(message.service());
    return AnswerUnary<HealthCheckRequest, HealthCheckResponse>(
        {calls_, budget_, kReplyBytes}, {"Health/Check", context}, on_disk ? disk_ : nullptr, request, response,
        [this, on_disk](const HealthCheckRequest& request) {
          const std::string& service = request.service();
          return Answer(on_disk ? health_.Find(service) : health_.Of(service), service);
        });
  }
  grpc::ServerUnaryReactor* const reactor = context->DefaultReactor();
  const absl::StatusOr<HealthCheckResponse> answer =
      parsed.ok() ? Answer(health_.Of(message.service()), message.service()) : parsed;
  if (answer.ok()) *response = SerializeMessage(*answer);
  reactor->Finish(ToRpcStatus(answer.status()));
  return reactor;
}

grpc::ServerWriteReactor<grpc::ByteBuffer>* HealthHandlers::Watch(grpc::CallbackServerContext* context,
                                                                  const grpc::ByteBuffer* request) {
  HealthCheckRequest message;
  absl::Status status = ParseSmallMessage(*request, &message);
  if (status.ok() && watch_count_ >= kMaxWatches) {
    status =
        absl::ResourceExhaustedError(absl::StrCat("the server has ", kMaxWatches, " watches of its health, its limit"));
  }
  return HealthWatch::Start(Health::IsMesh(message.service()) ? calls_ : &watches_, {"Health/Watch", context}, &health_,
                            disk_, status, message.service(), &watch_count_);
}

void HealthHandlers::Drain() {
  health_.Drain();
  watches_.Drain();
}

}  // namespace deltaray
