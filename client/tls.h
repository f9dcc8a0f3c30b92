// The client's side of TLS, and why a handshake fails: gRPC tells no more than that it did.

#ifndef CLIENT_TLS_H_
#define CLIENT_TLS_H_

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "client/security_flags.h"
#include "grpcpp/security/credentials.h"

struct ssl_ctx_st;

namespace deltaray {

class Tls {
 public:
  // Reads the files of `flags`. Fails, naming flag and file, where one cannot be read, is malformed, or does not match
  // the other.
  static absl::StatusOr<Tls> Read(const SecurityFlags& flags);

  std::shared_ptr<grpc::ChannelCredentials> Credentials() const { return grpc::SslCredentials(options_); }

  // Why a connection to `server` fails, found by a handshake of our own: that its certificate has expired, for
  // instance. Empty where that works, or nobody listens. Takes some seconds at most.
  std::string WhyNot(const std::string& server) const;

  // Whether who listens at `server` speaks TLS.
  static bool IsSpokenBy(const std::string& server);

 private:
  grpc::SslCredentialsOptions options_;
  std::shared_ptr<ssl_ctx_st> context_;
};

}  // namespace deltaray

#endif  // CLIENT_TLS_H_
