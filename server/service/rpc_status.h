// From absl::Status to what gRPC sends, and from exceptions to absl::Status.

#ifndef SERVER_SERVICE_RPC_STATUS_H_
#define SERVER_SERVICE_RPC_STATUS_H_

#include <exception>
#include <new>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "grpcpp/support/status.h"

namespace deltaray {

// The same code and text; a text of more than 1 KiB is cut, for it travels as a header. A status that is INTERNAL or
// UNKNOWN is logged, and sent as INTERNAL.
grpc::Status ToRpcStatus(const absl::Status& status);

// Runs body(), which returns absl::Status. An exception becomes a status: RESOURCE_EXHAUSTED for lack of memory, else
// INTERNAL. gRPC leaves a call open forever when an exception leaves a reaction.
template <typename Body>
absl::Status CatchExceptions(Body&& body) {
  try {
    return std::forward<Body>(body)();
  } catch (const std::bad_alloc&) {
    return absl::ResourceExhaustedError("the server has not enough memory for this request");
  } catch (const std::exception& e) {
    return absl::InternalError(absl::StrCat("unexpected failure: ", e.what()));
  }
}

}  // namespace deltaray

#endif  // SERVER_SERVICE_RPC_STATUS_H_
