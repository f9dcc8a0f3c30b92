#include "server/service/call_limits.h"

#include "absl/strings/str_cat.h"

namespace deltaray {
namespace {

constexpr std::string_view kStreamRays = "RayService/StreamRays";
constexpr std::string_view kUploadMesh = "MeshService/UploadMesh";

// Answers on their way, beside one for each place.
constexpr uint32_t kAnswersOnTheirWay = 16;

}  // namespace

CallLimits::CallLimits(const Options& options)
    : calls_{options.calls, "calls", "--max-calls"},
      streams_{options.streams, "streams", "--max-streams"},
      uploads_{options.uploads, "uploads", "--max-uploads"} {}

absl::Status CallLimits::Places::HasRoom() const {
  if (asking >= limit) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the server is at its limit of ", limit, " ", what, " at once (", flag, "); try again later"));
  }
  if (answered >= limit + kAnswersOnTheirWay) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "the answers of ", answered, " ", what, " were not taken yet by their clients (", flag, "); try again later"));
  }
  return absl::OkStatus();
}

absl::InlinedVector<CallLimits::Places*, 2> CallLimits::PlacesOf(std::string_view method) {
  if (method == kStreamRays) return {&calls_, &streams_};
  if (method == kUploadMesh) return {&calls_, &uploads_};
  return {&calls_};
}

absl::Status CallLimits::OnBegin(RpcInfo& rpc) {
  MutexLock lock(mutex_);
  const auto places = PlacesOf(rpc.method);
  for (const Places* place : places) {
    if (absl::Status status = place->HasRoom(); !status.ok()) return status;
  }
  for (Places* place : places) ++place->asking;
  answered_.emplace(rpc.context, false);
  return absl::OkStatus();
}

void CallLimits::OnAnswer(const RpcInfo& rpc) {
  MutexLock lock(mutex_);
  const auto call = answered_.find(rpc.context);
  if (call == answered_.end()) return;
  call->second = true;
  for (Places* place : PlacesOf(rpc.method)) --place->asking, ++place->answered;
}

void CallLimits::OnEnd(const RpcInfo& rpc, const absl::Status&) {
  MutexLock lock(mutex_);
  const auto call = answered_.find(rpc.context);
  if (call == answered_.end()) return;
  for (Places* place : PlacesOf(rpc.method)) --(call->second ? place->answered : place->asking);
  answered_.erase(call);
}

}  // namespace deltaray
