// SHA-256 over bytes that come in pieces.

#ifndef SERVER_STORE_SHA256_H_
#define SERVER_STORE_SHA256_H_

#include <memory>
#include <string>

#include "absl/strings/string_view.h"

struct evp_md_ctx_st;

namespace deltaray {

// Not thread-safe.
class Sha256 {
 public:
  static constexpr size_t kBytes = 32;

  Sha256();

  void Update(absl::string_view bytes);
  // The digest of all bytes so far, 32 bytes. REQUIRES: called once, last.
  std::string Finish();

  // The digest of `bytes` as 64 lower-case hexadecimal digits.
  static std::string Hex(absl::string_view bytes);

 private:
  struct Free {
    void operator()(evp_md_ctx_st* context) const;
  };
  std::unique_ptr<evp_md_ctx_st, Free> context_;
};

}  // namespace deltaray

#endif  // SERVER_STORE_SHA256_H_
