// Options that take one of a few names, and a check of numbers.

#ifndef CLIENT_NAMED_OPTION_H_
#define CLIENT_NAMED_OPTION_H_

#include <cmath>
#include <cstdlib>
#include <string>
#include <utility>
#include <vector>

#include "CLI/App.hpp"
#include "absl/strings/str_join.h"

namespace deltaray {

// CLI11's checks of ranges let it pass.
inline std::string NotNan(const std::string& number) {
  return std::isnan(std::strtod(number.c_str(), nullptr)) ? number + " is not a number" : "";
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
