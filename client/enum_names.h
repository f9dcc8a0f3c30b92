// Short names of the contract's enum values, as options and output show them: BUILD_PRESET_FAST is "fast",
// TREE_BUILDER_KD_TREE "kd_tree". They come from the generated descriptors, so that a value added to the contract is
// known at once.

#ifndef CLIENT_ENUM_NAMES_H_
#define CLIENT_ENUM_NAMES_H_

#include <string>

#include "CLI/App.hpp"
#include "client/named_option.h"
#include "google/protobuf/descriptor.h"
#include "google/protobuf/generated_enum_reflection.h"

namespace deltaray {

// "unspecified" for the value 0; the number in decimal for one that this client does not know.
std::string EnumName(const google::protobuf::EnumDescriptor& type, int value);

template <typename Enum>
std::string EnumName(Enum value) {
  return EnumName(*google::protobuf::GetEnumDescriptor<Enum>(), static_cast<int>(value));
}

// All values but the unspecified one, in the contract's order.
template <typename Enum>
NamedValues<Enum> EnumValues() {
  const google::protobuf::EnumDescriptor& type = *google::protobuf::GetEnumDescriptor<Enum>();
  NamedValues<Enum> values;
  for (int i = 0; i < type.value_count(); ++i) {
    const int number = type.value(i)->number();
    if (number != 0) values.emplace_back(EnumName(type, number), static_cast<Enum>(number));
  }
  return values;
}

// Adds an option that takes one of the names and hands its value to `set`.
template <typename Enum, typename Set>
CLI::Option* AddEnumOption(CLI::App& command, const std::string& option, Set set, const std::string& help) {
  return AddNamedOption(command, option, EnumValues<Enum>(), set, help);
}

}  // namespace deltaray

#endif  // CLIENT_ENUM_NAMES_H_
