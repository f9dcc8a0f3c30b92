#include "server/service/rpc_status.h"

#include <string>

#include "spdlog/spdlog.h"

namespace deltaray {
namespace {
// gRPC refuses headers of more than 8 KiB in all, and a client then sees no text at all.
constexpr size_t kMaxTextBytes = 1024;
}  // namespace

grpc::Status ToRpcStatus(const absl::Status& status) {
  if (status.ok()) return grpc::Status::OK;
  std::string text(status.message());
  if (text.size() > kMaxTextBytes) {
    text.resize(kMaxTextBytes);
    text += " ...";
  }
  if (status.code() == absl::StatusCode::kInternal || status.code() == absl::StatusCode::kUnknown) {
    spdlog::error("a call failed by a defect: {}", text);
    return {grpc::StatusCode::INTERNAL, text};
  }
  return {static_cast<grpc::StatusCode>(status.raw_code()), text};
}

}  // namespace deltaray
