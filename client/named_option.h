// Options that take one of a few names, and checks of numbers and files.

#ifndef CLIENT_NAMED_OPTION_H_
#define CLIENT_NAMED_OPTION_H_

#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "CLI/App.hpp"
#include "absl/strings/match.h"
#include "absl/strings/str_join.h"

namespace deltaray {

// CLI11's checks of ranges let it pass.
inline std::string NotNan(const std::string& number) {
  return std::isnan(std::strtod(number.c_str(), nullptr)) ? number + " is not a number" : "";
}

// A path or a name that is given, but empty, as where a script's variable is not set.
inline std::string NotEmpty(const std::string& text) { return text.empty() ? "is empty" : ""; }

// A check of the name of a file that is written in one format only, the one of `extension`, which has its dot. Names
// without one, as of devices and pipes, pass.
inline auto NoOtherExtension(const std::string& extension) {
  return [extension](const std::string& path) -> std::string {
    const std::string given = std::filesystem::path(path).extension().string();
    if (given.empty() || absl::EqualsIgnoreCase(given, extension)) return "";
    return "the name of the file must end in " + extension + ", which is the only format";
  };
}

// CLI11 takes negative numbers of 64 bits for great ones, and too great ones for the greatest.
inline std::string WholeNumber(const std::string& number) {
  uint64_t value;
  const char* const end = number.data() + number.size();
  const auto [rest, error] = std::from_chars(number.data(), end, value);
  return error == std::errc() && rest == end ? "" : number + " is not a whole number from 0 to 2^64 - 1";
}

// Names and what they stand for, in the order that --help shows them.
template <typename Value>
using NamedValues = std::vector<std::pair<std::string, Value>>;

// Adds an option that takes one of the names and hands its value to `set`.
template <typename Value, typename Set>
CLI::Option* AddNamedOption(CLI::App& command, const std::string& option, const NamedValues<Value>& values, Set set,
                            const std::string& help) {
  const auto parse = [values, set, option](const std::string& text) {
    for (const auto& [name, value] : values) {
      if (name == text) return set(value);
    }
    throw CLI::ValidationError(option, "'" + text + "' is not one of its values; see --help");
  };
  const std::string names =
      absl::StrJoin(values, "|", [](std::string* joined, const auto& named) { *joined += named.first; });
  return command.add_option_function<std::string>(option, parse, help)->type_name(names);
}

}  // namespace deltaray

#endif  // CLIENT_NAMED_OPTION_H_
