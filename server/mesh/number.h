// Numbers in text, whatever the locale.

#ifndef SERVER_MESH_NUMBER_H_
#define SERVER_MESH_NUMBER_H_

#include <charconv>
#include <cstdint>
#include <system_error>

#include "absl/strings/string_view.h"

namespace deltaray {

// The double nearest to the decimal number that is all of `token`, such as "1", "+.5", "-2.e-3". False for anything
// else, "nan", "inf" and hexadecimal included. What double cannot hold becomes ±inf or ±0.
bool ParseDouble(absl::string_view token, double* value);

// The decimal integer that is all of `token`. False where it is none or does not fit T.
template <typename T>
bool ParseInteger(absl::string_view token, T* value) {
  const char* end = token.data() + token.size();
  const auto [stop, error] = std::from_chars(token.data(), end, *value);
  return error == std::errc() && stop == end;
}

// Cuts the next token, a run of anything but spaces and tabs, off the front of `text`; empty where there is none.
inline absl::string_view NextToken(absl::string_view* text) {
  size_t begin = 0;
  while (begin < text->size() && ((*text)[begin] == ' ' || (*text)[begin] == '\t')) ++begin;
  size_t end = begin;
  while (end < text->size() && (*text)[end] != ' ' && (*text)[end] != '\t') ++end;
  const absl::string_view token = text->substr(begin, end - begin);
  text->remove_prefix(end);
  return token;
}

}  // namespace deltaray

#endif  // SERVER_MESH_NUMBER_H_
