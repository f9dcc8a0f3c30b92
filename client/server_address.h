// The address that --server names.

#ifndef CLIENT_SERVER_ADDRESS_H_
#define CLIENT_SERVER_ADDRESS_H_

#include <string>

#include "absl/strings/string_view.h"

namespace deltaray {

// What is wrong with `address`, as gRPC writes it: host:port, dns:[//authority/]host:port, ipv4: and ipv6: with one or
// more addresses between commas, all of which need a port of 1 to 65535; unix:, xds: and google-c2p: have none. Empty
// where nothing is. gRPC itself takes the digits that a port begins with, and of the number its last 16 bits; without a
// port, that of HTTPS.
std::string WrongWithServerAddress(absl::string_view address);

}  // namespace deltaray

#endif  // CLIENT_SERVER_ADDRESS_H_
