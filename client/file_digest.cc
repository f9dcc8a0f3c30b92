#include "client/file_digest.h"

#include <openssl/evp.h>

#include <memory>
#include <vector>

#include "client/exit_code.h"

namespace deltaray {

absl::StatusOr<std::string> Sha256OfRest(InputFile& file) {
  const std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context(EVP_MD_CTX_new(), EVP_MD_CTX_free);
  bool good = context && EVP_DigestInit_ex(context.get(), EVP_sha256(), nullptr) == 1;
  std::vector<char> buffer(1 << 20);
  while (good) {
    const absl::StatusOr<size_t> count = file.Read(std::span(buffer));
    if (!count.ok()) return count.status();
    if (*count == 0) break;
    good = EVP_DigestUpdate(context.get(), buffer.data(), *count) == 1;
  }
  std::string digest(EVP_MAX_MD_SIZE, '\0');
  unsigned int size = 0;
  good = good && EVP_DigestFinal_ex(context.get(), reinterpret_cast<unsigned char*>(digest.data()), &size) == 1;
  if (!good) return LocalError("OpenSSL cannot compute SHA-256");
  digest.resize(size);
  return digest;
}

}  // namespace deltaray
