// Messages of the contract as JSON and CSV, for programs to read.

#ifndef CLIENT_MESSAGE_TEXT_H_
#define CLIENT_MESSAGE_TEXT_H_

#include <string>

#include "CLI/App.hpp"
#include "google/protobuf/message.h"

namespace deltaray {

enum class DataFormat { kTable, kJson, kCsv };

// Adds --format table|json|csv.
void AddFormatFlag(CLI::App& command, DataFormat& format);

// The message as one line of JSON, ended by '\n': protobuf's JSON mapping with the field names of the contract and
// fields at their default value included. That mapping writes 64-bit integers as strings.
std::string JsonLine(const google::protobuf::Message& message);

// The message as CSV (RFC 4180, lines ended by '\n'). Fields of nested messages have columns of their own,
// "bounds.min.x"; elements of repeated messages are numbered, "phases.0.wall_seconds"; other repeated fields take one
// column, joined by ';'. Enums have their short names, times RFC 3339; unset fields are empty. Control characters are
// replaced, see Printable().
std::string CsvHeader(const google::protobuf::Message& message);
std::string CsvRow(const google::protobuf::Message& message);

// One field of CSV, in quotes where it needs them.
std::string CsvField(const std::string& text);

}  // namespace deltaray

#endif  // CLIENT_MESSAGE_TEXT_H_
