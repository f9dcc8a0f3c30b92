#include "server/service/tls_certificates.h"

#include <grpc/grpc.h>

#include <string>

#include "server/service/pem.h"

namespace deltaray {
namespace {

// gRPC has certificates that are asked for anew at each handshake in its C interface alone.
class FetchedCredentials final : public grpc::ServerCredentials {
 public:
  explicit FetchedCredentials(grpc_server_credentials* credentials) : credentials_(credentials) {}
  ~FetchedCredentials() override { grpc_server_credentials_release(credentials_); }

  // Tokens are looked at by Authenticator, whether there is TLS or not.
  void SetAuthMetadataProcessor(const std::shared_ptr<grpc::AuthMetadataProcessor>&) override {}

 private:
  int AddPortToServer(const std::string& address, grpc_server* server) override {
    return grpc_server_add_http2_port(server, address.c_str(), credentials_);
  }

  grpc_server_credentials* const credentials_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<TlsCertificates>> TlsCertificates::Start(const SecurityOptions& options) {
  const bool ask_clients = !options.tls_client_ca.empty();
  std::unique_ptr<TlsCertificates> certificates(new TlsCertificates(ask_clients));
  std::vector<ReloadedFile> files = {{"tls-cert", options.tls_cert, {}}, {"tls-key", options.tls_key, {}}};
  if (ask_clients) files.push_back({"tls-client-ca", options.tls_client_ca, {}});
  absl::StatusOr<std::unique_ptr<ReloadedFiles>> reloaded = ReloadedFiles::Start(
      std::move(files),
      [self = certificates.get()](const std::vector<ReloadedFile>& files) { return self->Load(files); });
  if (!reloaded.ok()) return reloaded.status();
  certificates->reloaded_ = *std::move(reloaded);
  return certificates;
}

absl::Status TlsCertificates::Load(const std::vector<ReloadedFile>& files) {
  if (absl::Status status = CheckKeyPair(files[0], files[1]); !status.ok()) return status;
  if (ask_clients_) {
    if (absl::Status status = CheckAuthorities(files[2]); !status.ok()) return status;
  }
  MutexLock lock(mutex_);
  files_ = files;
  given_ = false;
  return absl::OkStatus();
}

std::shared_ptr<grpc::ServerCredentials> TlsCertificates::Credentials() {
  grpc_ssl_server_credentials_options* const options = grpc_ssl_server_credentials_create_options_using_config_fetcher(
      ask_clients_ ? GRPC_SSL_REQUEST_AND_REQUIRE_CLIENT_CERTIFICATE_AND_VERIFY
                   : GRPC_SSL_DONT_REQUEST_CLIENT_CERTIFICATE,
      &TlsCertificates::Fetch, this);
  return std::make_shared<FetchedCredentials>(grpc_ssl_server_credentials_create_with_options(options));
}

grpc_ssl_certificate_config_reload_status TlsCertificates::Fetch(void* self,
                                                                 grpc_ssl_server_certificate_config** config) {
  return static_cast<TlsCertificates*>(self)->Give(config);
}

grpc_ssl_certificate_config_reload_status TlsCertificates::Give(grpc_ssl_server_certificate_config** config) {
  MutexLock lock(mutex_);
  if (given_) return GRPC_SSL_CERTIFICATE_CONFIG_RELOAD_UNCHANGED;
  const grpc_ssl_pem_key_cert_pair pair = {files_[1].bytes.c_str(), files_[0].bytes.c_str()};
  // Debug builds of gRPC insist on authorities even where no client is asked for a certificate.
  *config = grpc_ssl_server_certificate_config_create(files_[ask_clients_ ? 2 : 0].bytes.c_str(), &pair, 1);
  given_ = true;
  return GRPC_SSL_CERTIFICATE_CONFIG_RELOAD_NEW;
}

}  // namespace deltaray
