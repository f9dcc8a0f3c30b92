#include "server/service/call_limits.h"

#include "absl/strings/str_cat.h"

namespace deltaray {
namespace {

constexpr std::string_view kStreamRays = "RayService/StreamRays";
constexpr std::string_view kUploadMesh = "MeshService/UploadMesh";

// A client that does not take its answers has no more of them than that, beside the calls that it may make.
constexpr uint32_t kAnswersOnTheirWay = 64;

absl::Status Refusal(uint32_t limit, const char* what, const char* flag) {
  return absl::ResourceExhaustedError(
      absl::StrCat("the server is at its limit of ", limit, " ", what, " at once (", flag, "); try again later"));
}

}  // namespace

absl::Status CallLimits::OnBegin(RpcInfo& rpc) {
  const bool stream = rpc.method == kStreamRays, upload = rpc.method == kUploadMesh;
  MutexLock lock(mutex_);
  absl::Status status;
  if (calls_ >= options_.calls || answered_ >= options_.calls + kAnswersOnTheirWay) {
    status = Refusal(options_.calls, "calls", "--max-calls");
  } else if (stream && streams_ >= options_.streams) {
    status = Refusal(options_.streams, "streams", "--max-streams");
  } else if (upload && uploads_ >= options_.uploads) {
    status = Refusal(options_.uploads, "uploads", "--max-uploads");
  }
  if (!status.ok()) {
    refused_.insert(rpc.context);
    return status;
  }
  ++calls_;
  streams_ += stream;
  uploads_ += upload;
  return status;
}

void CallLimits::OnAnswer(const RpcInfo& rpc) {
  MutexLock lock(mutex_);
  if (refused_.count(rpc.context) != 0) return;
  --calls_;
  ++answered_;
  streams_ -= rpc.method == kStreamRays;
  uploads_ -= rpc.method == kUploadMesh;
}

void CallLimits::OnEnd(const RpcInfo& rpc, const absl::Status&) {
  MutexLock lock(mutex_);
  if (refused_.erase(rpc.context) == 0) --answered_;
}

}  // namespace deltaray
