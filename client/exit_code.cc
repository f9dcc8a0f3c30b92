#include "client/exit_code.h"

#include <string>

#include "absl/strings/cord.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "client/text_table.h"

namespace deltaray {
namespace {

constexpr char kPayload[] = "deltaray.exit_code";

absl::Status WithExitCode(absl::StatusCode code, absl::string_view message, int exit_code) {
  absl::Status status(code, message);
  status.SetPayload(kPayload, absl::Cord(absl::StrCat(exit_code)));
  return status;
}

}  // namespace

absl::Status LocalError(absl::string_view message) {
  return WithExitCode(absl::StatusCode::kUnknown, message, kExitLocalFailure);
}

absl::Status UsageError(absl::string_view message) {
  return WithExitCode(absl::StatusCode::kInvalidArgument, message, kExitUsage);
}

absl::Status FromRpc(const grpc::Status& status) {
  if (status.ok()) return absl::OkStatus();
  // gRPC's codes and Abseil's are the same numbers.
  const int code = status.error_code();
  return WithExitCode(static_cast<absl::StatusCode>(code), status.error_message(), kExitRpcBase + code);
}

grpc::Status WithRequestId(const grpc::Status& status, const grpc::ClientContext& context) {
  const auto& trailers = context.GetServerTrailingMetadata();
  const auto id = trailers.find("x-request-id");
  if (status.ok() || id == trailers.end()) return status;
  return {status.error_code(), absl::StrCat(status.error_message(), " (request ",
                                            absl::string_view(id->second.data(), id->second.size()), ")")};
}

absl::Status Interrupted() { return FromRpc(grpc::Status(grpc::StatusCode::CANCELLED, "interrupted")); }

absl::Status OutputClosed() { return WithExitCode(absl::StatusCode::kCancelled, "output closed", 0); }

bool IsOutputClosed(const absl::Status& status) { return !status.ok() && ExitCode(status) == 0; }

int ExitCode(const absl::Status& status) {
  if (status.ok()) return 0;
  int exit_code = kExitLocalFailure;
  if (const auto payload = status.GetPayload(kPayload)) {
    if (!absl::SimpleAtoi(std::string(*payload), &exit_code)) exit_code = kExitLocalFailure;
  }
  return exit_code;
}

std::string ErrorText(const absl::Status& status) {
  std::string text = Printable(status.message());
  if (ExitCode(status) >= kExitRpcBase) absl::StrAppend(&text, " (", absl::StatusCodeToString(status.code()), ")");
  return text;
}

}  // namespace deltaray
