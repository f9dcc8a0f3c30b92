// Checksums of files.

#ifndef CLIENT_FILE_DIGEST_H_
#define CLIENT_FILE_DIGEST_H_

#include <string>

#include "absl/status/statusor.h"
#include "client/input_file.h"

namespace deltaray {

// SHA-256, 32 bytes, of all that is left to read of the file.
absl::StatusOr<std::string> Sha256OfRest(InputFile& file);

}  // namespace deltaray

#endif  // CLIENT_FILE_DIGEST_H_
