#include "client/message_text.h"

#include <charconv>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "client/enum_names.h"
#include "client/named_option.h"
#include "client/text_table.h"
#include "google/protobuf/timestamp.pb.h"
#include "google/protobuf/util/json_util.h"
#include "google/protobuf/util/time_util.h"

namespace deltaray {
namespace {

using google::protobuf::FieldDescriptor;
using google::protobuf::Message;
using google::protobuf::Reflection;

// Column name and text of each field of a message.
using Columns = std::vector<std::pair<std::string, std::string>>;

// The shortest text that reads back as the same number.
std::string NumberText(double number) {
  char buffer[32];
  return std::string(buffer, std::to_chars(buffer, buffer + sizeof(buffer), number).ptr);
}

// One value of a field that is not a message; `index` is -1 for a singular field.
std::string ValueText(const Message& message, const FieldDescriptor& field, int index) {
  const Reflection& reflection = *message.GetReflection();
  const bool repeated = index >= 0;
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_UINT32:
      return absl::StrCat(repeated ? reflection.GetRepeatedUInt32(message, &field, index)
                                   : reflection.GetUInt32(message, &field));
    case FieldDescriptor::CPPTYPE_UINT64:
      return absl::StrCat(repeated ? reflection.GetRepeatedUInt64(message, &field, index)
                                   : reflection.GetUInt64(message, &field));
    case FieldDescriptor::CPPTYPE_DOUBLE:
      return NumberText(repeated ? reflection.GetRepeatedDouble(message, &field, index)
                                 : reflection.GetDouble(message, &field));
    case FieldDescriptor::CPPTYPE_BOOL:
      return (repeated ? reflection.GetRepeatedBool(message, &field, index) : reflection.GetBool(message, &field))
                 ? "true"
                 : "false";
    case FieldDescriptor::CPPTYPE_ENUM:
      return EnumName(*field.enum_type(), repeated ? reflection.GetRepeatedEnumValue(message, &field, index)
                                                   : reflection.GetEnumValue(message, &field));
    case FieldDescriptor::CPPTYPE_STRING:
      return Printable(repeated ? reflection.GetRepeatedString(message, &field, index)
                                : reflection.GetString(message, &field));
    default:
      // The contract's messages that are shown have no fields of other types.
      return "";
  }
}

void AppendColumns(const Message& message, const std::string& prefix, bool set, Columns* columns);

void AppendMessageField(const Message& message, const FieldDescriptor& field, const std::string& name, bool set,
                        Columns* columns) {
  const Reflection& reflection = *message.GetReflection();
  if (field.is_repeated()) {
    for (int i = 0; i < reflection.FieldSize(message, &field); ++i) {
      AppendColumns(reflection.GetRepeatedMessage(message, &field, i), absl::StrCat(name, ".", i, "."), set, columns);
    }
    return;
  }
  set = set && reflection.HasField(message, &field);
  const Message& value = reflection.GetMessage(message, &field);
  if (const auto* time = dynamic_cast<const google::protobuf::Timestamp*>(&value)) {
    columns->emplace_back(name, set ? google::protobuf::util::TimeUtil::ToString(*time) : "");
  } else {
    AppendColumns(value, name + ".", set, columns);
  }
}

// `set` is false inside an unset message, which has the same columns as a set one, all empty.
void AppendColumns(const Message& message, const std::string& prefix, bool set, Columns* columns) {
  const Reflection& reflection = *message.GetReflection();
  for (int i = 0; i < message.GetDescriptor()->field_count(); ++i) {
    const FieldDescriptor& field = *message.GetDescriptor()->field(i);
    const std::string name = prefix + field.name();
    if (field.cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE) {
      AppendMessageField(message, field, name, set, columns);
    } else if (field.is_repeated()) {
      std::vector<std::string> values;
      for (int j = 0; j < reflection.FieldSize(message, &field); ++j) values.push_back(ValueText(message, field, j));
      columns->emplace_back(name, absl::StrJoin(values, ";"));
    } else {
      const bool has_value = set && (!field.has_presence() || reflection.HasField(message, &field));
      columns->emplace_back(name, has_value ? ValueText(message, field, -1) : "");
    }
  }
}

Columns AllColumns(const Message& message) {
  Columns columns;
  AppendColumns(message, "", /*set=*/true, &columns);
  return columns;
}

}  // namespace

void AddFormatFlag(CLI::App& command, DataFormat& format) {
  AddNamedOption<DataFormat>(
      command, "--format", {{"table", DataFormat::kTable}, {"json", DataFormat::kJson}, {"csv", DataFormat::kCsv}},
      [&format](DataFormat value) { format = value; }, "Format of the output [table]");
}

std::string JsonLine(const Message& message) {
  google::protobuf::util::JsonPrintOptions options;
  options.always_print_primitive_fields = true;
  options.preserve_proto_field_names = true;
  std::string line;
  // Fails only for messages with fields of type Any, which the contract has none of.
  (void)google::protobuf::util::MessageToJsonString(message, &line, options);
  return line + '\n';
}

std::string CsvField(const std::string& text) {
  if (text.find_first_of(",\"\r\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + '"';
}

std::string CsvHeader(const Message& message) {
  return absl::StrCat(absl::StrJoin(AllColumns(message), ",",
                                    [](std::string* line, const auto& column) { *line += CsvField(column.first); }),
                      "\n");
}

std::string CsvRow(const Message& message) {
  return absl::StrCat(absl::StrJoin(AllColumns(message), ",",
                                    [](std::string* line, const auto& column) { *line += CsvField(column.second); }),
                      "\n");
}

}  // namespace deltaray
