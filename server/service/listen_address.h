// The address that the server listens at.

#ifndef SERVER_SERVICE_LISTEN_ADDRESS_H_
#define SERVER_SERVICE_LISTEN_ADDRESS_H_

#include "absl/strings/string_view.h"

namespace deltaray {

// Whether only this machine can reach `address`, as gRPC writes it: host:port with a host of 127.0.0.0/8, [::1] or
// localhost, or unix:path.
bool IsLoopback(absl::string_view address);

}  // namespace deltaray

#endif  // SERVER_SERVICE_LISTEN_ADDRESS_H_
