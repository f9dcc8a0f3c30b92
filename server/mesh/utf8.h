// Text that may stand in a message: valid UTF-8.

#ifndef SERVER_MESH_UTF8_H_
#define SERVER_MESH_UTF8_H_

#include <string>

#include "absl/strings/string_view.h"

namespace deltaray {

// `text` with each byte that is not part of a valid UTF-8 sequence, and each control character, replaced by U+FFFD.
std::string ToValidUtf8(absl::string_view text);

}  // namespace deltaray

#endif  // SERVER_MESH_UTF8_H_
