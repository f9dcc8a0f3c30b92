#include "server/store/mesh_name.h"

#include <algorithm>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "server/mesh/utf8.h"
#include "server/store/mesh_store.h"

namespace deltaray {
namespace {

constexpr size_t kMaxNameBytes = 128;

// The control characters past ASCII, U+0080 to U+009F, in UTF-8.
bool HasWideControl(absl::string_view text) {
  return std::adjacent_find(text.begin(), text.end(), [](char a, char b) {
           return a == '\xC2' && static_cast<uint8_t>(b) >= 0x80 && static_cast<uint8_t>(b) < 0xA0;
         }) != text.end();
}

}  // namespace

bool IsMeshId(absl::string_view text) {
  return text.size() == 64 &&
         std::all_of(text.begin(), text.end(), [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); });
}

absl::Status ValidateMeshName(absl::string_view name) {
  if (name.empty() || name.size() > kMaxNameBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("a mesh's name has 1 to ", kMaxNameBytes, " bytes, not ", name.size()));
  }
  if (ToValidUtf8(name) != name || HasWideControl(name)) {
    return absl::InvalidArgumentError("a mesh's name is UTF-8 without control characters");
  }
  if (IsMeshId(name)) {
    return absl::InvalidArgumentError("a mesh's name has not the form of a mesh id (64 lower-case hexadecimal digits)");
  }
  return absl::OkStatus();
}

}  // namespace deltaray
