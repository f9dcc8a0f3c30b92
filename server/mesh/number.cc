#include "server/mesh/number.h"

#include <limits>

#include "absl/strings/charconv.h"

namespace deltaray {
namespace {

bool IsDigit(char c) { return c >= '0' && c <= '9'; }

}  // namespace

bool ParseDouble(absl::string_view token, double* value) {
  const bool has_sign = !token.empty() && (token[0] == '+' || token[0] == '-');
  const absl::string_view magnitude = token.substr(has_sign ? 1 : 0);
  // Also keeps out "nan" and "inf", which the standard function takes.
  if (magnitude.empty() || !(IsDigit(magnitude[0]) || magnitude[0] == '.')) return false;
  if (token[0] == '+') token.remove_prefix(1);
  const char* end = token.data() + token.size();
  const auto [stop, error] = std::from_chars(token.data(), end, *value);
  if (stop != end) return false;
  if (error == std::errc::result_out_of_range) {
    // The standard function does not say whether the number is too large or too small; Abseil's does, by its value.
    absl::from_chars(token.data(), end, *value);
    if (*value > 1) *value = std::numeric_limits<double>::infinity();
    if (*value < -1) *value = -std::numeric_limits<double>::infinity();
    return true;
  }
  return error == std::errc();
}

}  // namespace deltaray
