#include "server/store/mesh_name.h"

#include <algorithm>
#include <cstdint>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "server/store/mesh_store.h"

namespace deltaray {
namespace {

constexpr size_t kMaxNameBytes = 128;

// Takes one code point off the front of `text`. False where what is there is not UTF-8: overlong forms, surrogates and
// what is past U+10FFFF are not.
bool TakeCodePoint(absl::string_view* text, uint32_t* code_point) {
  const auto byte = [&](size_t i) { return static_cast<uint8_t>((*text)[i]); };
  const uint8_t first = byte(0);
  const size_t length = first < 0x80   ? 1
                        : first < 0xC0 ? 0
                        : first < 0xE0 ? 2
                        : first < 0xF0 ? 3
                        : first < 0xF8 ? 4
                                       : 0;
  if (length == 0 || text->size() < length) return false;
  uint32_t value = length == 1 ? first : first & (0x7F >> length);
  for (size_t i = 1; i < length; ++i) {
    if ((byte(i) & 0xC0) != 0x80) return false;
    value = value << 6 | (byte(i) & 0x3F);
  }
  constexpr uint32_t kLeast[] = {0, 0, 0x80, 0x800, 0x10000};
  if (value < kLeast[length] || value > 0x10FFFF || (value >= 0xD800 && value <= 0xDFFF)) return false;
  text->remove_prefix(length);
  *code_point = value;
  return true;
}

}  // namespace

bool IsMeshId(absl::string_view text) {
  return text.size() == 64 &&
         std::all_of(text.begin(), text.end(), [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); });
}

absl::Status ValidateMeshName(absl::string_view name) {
  if (name.empty() || name.size() > kMaxNameBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("name: has ", name.size(), " bytes; a mesh's name has 1 to ", kMaxNameBytes));
  }
  for (absl::string_view rest = name; !rest.empty();) {
    const size_t position = name.size() - rest.size();
    uint32_t code_point = 0;
    if (!TakeCodePoint(&rest, &code_point)) {
      return absl::InvalidArgumentError(absl::StrCat("name: byte ", position, " is not UTF-8"));
    }
    if (code_point < 0x20 || (code_point >= 0x7F && code_point < 0xA0)) {
      return absl::InvalidArgumentError(absl::StrCat("name: byte ", position, " is a control character"));
    }
  }
  if (IsMeshId(name)) {
    return absl::InvalidArgumentError("name: has the form of a mesh id (64 lower-case hexadecimal digits)");
  }
  return absl::OkStatus();
}

}  // namespace deltaray
