// How the server protects itself: which files say so, and which addresses that allows.

#ifndef SERVER_SERVICE_SECURITY_OPTIONS_H_
#define SERVER_SERVICE_SECURITY_OPTIONS_H_

#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"

namespace deltaray {

// Paths of files; empty: not used. All are read again when they change.
struct SecurityOptions {
  std::string tls_cert;       // PEM: the server's certificate, then those that lead to its authority
  std::string tls_key;        // PEM: the private key of the first one, not encrypted
  std::string tls_client_ca;  // PEM: authorities; a client must show a certificate of one of them
  std::string token_file;     // see token_file.h

  bool tls() const { return !tls_cert.empty(); }
};

// INVALID_ARGUMENT, naming the flag, where one needs another, or where other machines can reach `listen`, the
// connection is not encrypted, and `insecure_listen` does not say that this is meant.
absl::Status ValidateSecurity(const SecurityOptions& options, absl::string_view listen, bool insecure_listen);

}  // namespace deltaray

#endif  // SERVER_SERVICE_SECURITY_OPTIONS_H_
