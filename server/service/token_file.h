// Who may do what: a file of bearer tokens and their roles.
//
// A line: role, blanks, the SHA-256 of a token as 64 hexadecimal digits. From a # on it is a comment; empty lines count
// for nothing. The tokens themselves are not in the file, so that it may be read by who may not call. As the digests
// are not salted, tokens must be too many to be guessed: 128 random bits or more.
//
//     # printf %s "$(openssl rand -hex 32 | tee token)" | sha256sum
//     read   9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08  # the renderers
//     write  60303ae22b998861bce3b28f33eec1be758a213c86c93c076dbe9f558c11c752  # who uploads

#ifndef SERVER_SERVICE_TOKEN_FILE_H_
#define SERVER_SERVICE_TOKEN_FILE_H_

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace deltaray {

enum class Role {
  kRead,   // queries
  kWrite,  // uploads, names, deletes and rebuilds too
};

// The tokens of one file. Immutable, hence thread-safe.
class TokenTable {
 public:
  // INVALID_ARGUMENT, naming the line but nothing that may be a token, where the text is not of the form above, lists
  // one token twice, an empty one, or none at all.
  static absl::StatusOr<TokenTable> Parse(absl::string_view text);

  // The role of a token; nothing where it is not listed. Takes as long for every token of a length.
  std::optional<Role> Find(absl::string_view token) const;

  size_t size() const { return entries_.size(); }

 private:
  struct Entry {
    std::string digest;  // 64 lower-case hexadecimal digits
    Role role;
  };
  std::vector<Entry> entries_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_TOKEN_FILE_H_
