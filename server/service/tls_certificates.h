// The server's side of TLS, with certificates that are read again when they change.

#ifndef SERVER_SERVICE_TLS_CERTIFICATES_H_
#define SERVER_SERVICE_TLS_CERTIFICATES_H_

#include <grpc/grpc_security.h>

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "grpcpp/security/server_credentials.h"
#include "server/build/mutex.h"
#include "server/service/reloaded_files.h"
#include "server/service/security_options.h"

namespace deltaray {

// TLS 1.2 or 1.3. Each handshake takes the newest certificates that were good; connections under way stay as they are.
//
// gRPC's own FileWatcherCertificateProvider would not do: with a new file that is malformed, or does not match the
// other one, 1.51 drops the old certificate and refuses every handshake.
class TlsCertificates {
 public:
  // Reads the files of `options`, of which tls() holds. INVALID_ARGUMENT, naming flag and file, where one cannot be
  // read, is malformed, or does not match the other; new ones like that are logged, and the former stay.
  static absl::StatusOr<std::unique_ptr<TlsCertificates>> Start(const SecurityOptions& options);

  // For one port of a server, which must end before this.
  std::shared_ptr<grpc::ServerCredentials> Credentials();

 private:
  explicit TlsCertificates(bool ask_clients) : ask_clients_(ask_clients) {}

  absl::Status Load(const std::vector<ReloadedFile>& files);
  // What gRPC calls before each handshake.
  static grpc_ssl_certificate_config_reload_status Fetch(void* self, grpc_ssl_server_certificate_config** config);
  grpc_ssl_certificate_config_reload_status Give(grpc_ssl_server_certificate_config** config);

  const bool ask_clients_;
  Mutex mutex_;
  std::vector<ReloadedFile> files_ ABSL_GUARDED_BY(mutex_);  // certificate, key, and authorities of clients, if any
  bool given_ ABSL_GUARDED_BY(mutex_) = false;               // to gRPC
  std::unique_ptr<ReloadedFiles> reloaded_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_TLS_CERTIFICATES_H_
