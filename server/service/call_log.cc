#include "server/service/call_log.h"

#include <algorithm>
#include <chrono>
#include <random>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "server/service/log.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

constexpr char kRequestId[] = "x-request-id";
constexpr size_t kMaxRequestIdBytes = 64;

std::string RandomPrefix() {
  std::random_device random;
  return absl::StrCat(absl::Hex(random(), absl::kZeroPad8), absl::Hex(random(), absl::kZeroPad8), "-");
}

spdlog::level::level_enum Level(absl::StatusCode code) {
  switch (code) {
    case absl::StatusCode::kOk:
      return spdlog::level::debug;
    case absl::StatusCode::kUnknown:
    case absl::StatusCode::kInternal:
    case absl::StatusCode::kDataLoss:
      return spdlog::level::warn;
    default:
      return spdlog::level::info;
  }
}

}  // namespace

CallLog::CallLog() : prefix_(RandomPrefix()) {}

absl::Status CallLog::OnBegin(RpcInfo& rpc) {
  // gRPC forgets it once the client has gone, or was cut off.
  rpc.record->peer = rpc.context->peer();
  const auto sent = rpc.context->client_metadata().find(kRequestId);
  if (sent != rpc.context->client_metadata().end() && !sent->second.empty() &&
      sent->second.size() <= kMaxRequestIdBytes &&
      std::all_of(sent->second.begin(), sent->second.end(), absl::ascii_isgraph)) {
    rpc.record->request_id.assign(sent->second.data(), sent->second.size());
  } else {
    rpc.record->request_id = absl::StrCat(prefix_, ++last_);
  }
  rpc.context->AddTrailingMetadata(kRequestId, rpc.record->request_id);
  return absl::OkStatus();
}

void CallLog::OnEnd(const RpcInfo& rpc, const absl::Status& status) {
  const auto level = Level(status.code());
  if (!spdlog::should_log(level)) return;
  const double ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - rpc.began).count();
  const std::string code = absl::StatusCodeToString(status.code());
  const std::string text(status.message());
  LogFields fields{{"method", rpc.method},
                   {"peer", rpc.record->peer},
                   {"code", code},
                   {"ms", ms},
                   {"batches", static_cast<int64_t>(rpc.record->batches)},
                   {"rays", static_cast<int64_t>(rpc.record->rays)}};
  if (!status.ok()) fields.emplace_back("error", text);
  const LogScope scope(rpc.record->request_id);
  LogEvent(level, "call", fields);
}

}  // namespace deltaray
