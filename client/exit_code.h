// Errors of a command, and the exit code that each ends the program with:
//   0       success
//   1       local failure: a file, the terminal, malformed input, a build that failed
//   2       usage: an option or its value is wrong
//   64 + n  the RPC failed with the gRPC code n; NOT_FOUND, 5, gives 69
// All functions of the client return absl::Status; the exit code travels in a payload of it, so that a NOT_FOUND of the
// server and a file that is not found keep apart.

#ifndef CLIENT_EXIT_CODE_H_
#define CLIENT_EXIT_CODE_H_

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "grpcpp/client_context.h"
#include "grpcpp/support/status.h"

namespace deltaray {

constexpr int kExitLocalFailure = 1;
constexpr int kExitUsage = 2;
constexpr int kExitRpcBase = 64;

// A failure on this side. Exit code 1.
absl::Status LocalError(absl::string_view message);

// A wrong option. Exit code 2.
absl::Status UsageError(absl::string_view message);

// What an RPC ended with: OK, or its code and text. Exit code 64 + code.
absl::Status FromRpc(const grpc::Status& status);

// `status` of a call that has ended; the text of an error also tells the request id that the server gave the call, by
// which its log tells more.
grpc::Status WithRequestId(const grpc::Status& status, const grpc::ClientContext& context);

// The program was told to stop. Exit code 64 + CANCELLED.
absl::Status Interrupted();

// The reader of our output has gone. Not a failure: the program ends quietly, exit code 0.
absl::Status OutputClosed();

// Whether the status is that of OutputClosed().
bool IsOutputClosed(const absl::Status& status);

// The exit code that a command that returned the status ends with. Errors made by none of the above give 1.
int ExitCode(const absl::Status& status);

// The line that tells of the error, without line end: the text, and the name of the gRPC code where an RPC failed.
// Control characters are replaced, since parts of it may come out of a hostile file.
std::string ErrorText(const absl::Status& status);

}  // namespace deltaray

#endif  // CLIENT_EXIT_CODE_H_
