#include "client/mesh_key.h"

#include <cstddef>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/exit_code.h"
#include "client/output_file.h"
#include "client/text_table.h"

namespace deltaray {
namespace {

// Bytes of the UTF-8 sequence that `text` begins with; 0 where it begins with none. No sequence is longer than need be,
// stands for half of a pair of UTF-16, or for more than U+10FFFF.
size_t Utf8Sequence(absl::string_view text) {
  const auto byte = [&](size_t i) { return static_cast<unsigned char>(i < text.size() ? text[i] : 0); };
  const unsigned char first = byte(0);
  if (first < 0x80) return 1;
  if (first < 0xC2 || first > 0xF4) return 0;
  const unsigned char least = first == 0xE0 ? 0xA0 : first == 0xF0 ? 0x90 : 0x80;
  const unsigned char most = first == 0xED ? 0x9F : first == 0xF4 ? 0x8F : 0xBF;
  if (byte(1) < least || byte(1) > most) return 0;
  const size_t size = first < 0xE0 ? 2 : first < 0xF0 ? 3 : 4;
  for (size_t i = 2; i < size; ++i) {
    if ((byte(i) & 0xC0) != 0x80) return 0;
  }
  return size;
}

}  // namespace

std::string Utf8(const std::string& text) {
  for (absl::string_view rest = text; !rest.empty();) {
    const size_t size = Utf8Sequence(rest);
    if (size == 0) return "is not UTF-8";
    rest.remove_prefix(size);
  }
  return "";
}

void AddMeshArgument(CLI::App& command, std::function<void(const std::string&)> set) {
  command.add_option_function<std::string>("MESH", std::move(set), "Id or name")->required()->check(Utf8);
}

absl::Status WriteMeshId(const Session& session, absl::string_view id) {
  if (id.empty()) return LocalError("the server's answer has no mesh id");
  return WriteOutput(session.output, absl::StrCat(Printable(id), "\n"));
}

}  // namespace deltaray
