#include "server/service/token_file.h"

#include <openssl/crypto.h>

#include <algorithm>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "server/store/sha256.h"

namespace deltaray {
namespace {

constexpr size_t kDigits = 2 * Sha256::kBytes;

absl::Status LineError(size_t line, absl::string_view what) {
  return absl::InvalidArgumentError(absl::StrCat("line ", line, ": ", what));
}

}  // namespace

absl::StatusOr<TokenTable> TokenTable::Parse(absl::string_view text) {
  TokenTable table;
  size_t number = 0;
  for (const absl::string_view line : absl::StrSplit(text, '\n')) {
    ++number;
    const absl::string_view content = line.substr(0, line.find('#'));
    const std::vector<absl::string_view> words = absl::StrSplit(content, absl::ByAnyChar(" \t\r"), absl::SkipEmpty());
    if (words.empty()) continue;
    if (words[0] != "read" && words[0] != "write") return LineError(number, "the first word must be 'read' or 'write'");
    if (words.size() != 2 || words[1].size() != kDigits ||
        !std::all_of(words[1].begin(), words[1].end(), absl::ascii_isxdigit)) {
      return LineError(number, "behind the role must stand the SHA-256 of a token, 64 hexadecimal digits, and no more");
    }
    Entry entry{absl::AsciiStrToLower(words[1]), words[0] == "read" ? Role::kRead : Role::kWrite};
    // A pipeline makes it of a file of a token that is empty, and would let in whoever says no more than "Bearer ".
    if (entry.digest == Sha256::Hex("")) return LineError(number, "this is the SHA-256 of an empty token");
    if (std::ranges::find(table.entries_, entry.digest, &Entry::digest) != table.entries_.end()) {
      return LineError(number, "this token is on an earlier line already");
    }
    table.entries_.push_back(std::move(entry));
  }
  if (table.entries_.empty()) return absl::InvalidArgumentError("holds no token, so that nobody could call");
  return table;
}

std::optional<Role> TokenTable::Find(absl::string_view token) const {
  const std::string digest = Sha256::Hex(token);
  std::optional<Role> role;
  for (const Entry& entry : entries_) {
    if (CRYPTO_memcmp(entry.digest.data(), digest.data(), kDigits) == 0) role = entry.role;
  }
  return role;
}

}  // namespace deltaray
