// How the client proves who it is and whom it trusts, as the flags and the environment say.

#ifndef CLIENT_SECURITY_FLAGS_H_
#define CLIENT_SECURITY_FLAGS_H_

#include <string>

#include "absl/status/statusor.h"

namespace CLI {
class App;
}  // namespace CLI

namespace deltaray {

struct SecurityFlags {
  bool tls = false;             // wanted even where no file below is given
  std::string ca_file = {};     // authorities in PEM; empty: those of the system
  std::string cert_file = {};   // certificate of the client in PEM; empty: none
  std::string key_file = {};    // its private key
  std::string token_file = {};  // its first line is the token
  std::string token = {};       // from the environment; never a flag, which all users of the machine could read
  bool insecure_token = false;

  bool UsesTls() const { return tls || !ca_file.empty() || !cert_file.empty() || !key_file.empty(); }
};

void AddSecurityFlags(CLI::App& app, SecurityFlags& flags);

// Whether the way to the server does not leave this machine, as far as its address tells.
bool StaysHere(const std::string& server);

// The token to send to `server`; empty: none. A UsageError where it would travel in plaintext to another machine and
// insecure_token does not say that this is meant.
absl::StatusOr<std::string> ReadToken(const SecurityFlags& flags, const std::string& server);

}  // namespace deltaray

#endif  // CLIENT_SECURITY_FLAGS_H_
