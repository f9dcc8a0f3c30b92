#include "server/service/security_options.h"

#include "absl/strings/str_cat.h"
#include "server/service/listen_address.h"

namespace deltaray {

absl::Status ValidateSecurity(const SecurityOptions& options, absl::string_view listen, bool insecure_listen) {
  if (options.tls_cert.empty() != options.tls_key.empty()) {
    return absl::InvalidArgumentError(options.tls_cert.empty() ? "--tls-key: --tls-cert is missing"
                                                               : "--tls-cert: --tls-key is missing");
  }
  if (!options.tls_client_ca.empty() && !options.tls()) {
    return absl::InvalidArgumentError("--tls-client-ca: --tls-cert and --tls-key are missing");
  }
  if (options.tls() || insecure_listen || IsLoopback(listen)) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("--listen: other machines can reach ", listen, ", and the connection is not encrypted",
                   options.token_file.empty() ? "" : ", so that they can read tokens",
                   "; give --tls-cert and --tls-key, or say --insecure-listen if that is meant"));
}

}  // namespace deltaray
