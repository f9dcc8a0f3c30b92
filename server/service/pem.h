// What OpenSSL thinks of certificates and keys, before gRPC gets them: gRPC itself would only refuse every handshake.

#ifndef SERVER_SERVICE_PEM_H_
#define SERVER_SERVICE_PEM_H_

#include "absl/status/status.h"
#include "server/service/reloaded_files.h"

namespace deltaray {

// OK where a server can use the certificates, its own first, and the private key. INVALID_ARGUMENT names flag and file.
// What is no longer or not yet valid is logged, and OK: clocks differ, and clients judge for themselves.
absl::Status CheckKeyPair(const ReloadedFile& certificates, const ReloadedFile& key);

// OK where the file holds certificates.
absl::Status CheckAuthorities(const ReloadedFile& authorities);

}  // namespace deltaray

#endif  // SERVER_SERVICE_PEM_H_
