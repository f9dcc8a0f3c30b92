// The address that the server listens at.

#ifndef SERVER_SERVICE_LISTEN_ADDRESS_H_
#define SERVER_SERVICE_LISTEN_ADDRESS_H_

#include "absl/status/status.h"
#include "absl/strings/string_view.h"

namespace deltaray {

// INVALID_ARGUMENT unless `address` is host:port, with a port of 0 to 65535 and brackets around a host of IPv6, or
// unix:path. gRPC takes any number for a port, and listens at its last 16 bits.
absl::Status ValidateListenAddress(absl::string_view address);

// The same for metrics: host:port alone, or empty for none.
absl::Status ValidateMetricsAddress(absl::string_view address);

// Whether only this machine can reach `address`, as gRPC writes it: host:port with a host of 127.0.0.0/8, [::1] or
// localhost, or unix:path.
bool IsLoopback(absl::string_view address);

}  // namespace deltaray

#endif  // SERVER_SERVICE_LISTEN_ADDRESS_H_
