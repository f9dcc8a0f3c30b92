// Aligned text for people.

#ifndef CLIENT_TEXT_TABLE_H_
#define CLIENT_TEXT_TABLE_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"

namespace deltaray {

enum class Align { kLeft, kRight };

// Rows of cells, each column as wide as its widest cell, two spaces between columns, no spaces at the ends of lines.
// Cells are UTF-8; their control characters are replaced, see Printable().
class TextTable {
 public:
  explicit TextTable(std::vector<Align> columns) : columns_(std::move(columns)) {}

  // Adds a row. It may have fewer cells than there are columns, not more.
  void Add(std::vector<std::string> cells);

  // All rows, each ended by '\n'.
  std::string Render() const;

 private:
  std::vector<Align> columns_;
  std::vector<std::vector<std::string>> rows_;
};

// The text with control characters replaced by '?': names of groups and warnings come out of mesh files, and must not
// drive the terminal.
std::string Printable(absl::string_view text);

// 1234567 -> "1,234,567".
std::string GroupDigits(uint64_t number);

// 1536 -> "1.5 KiB".
std::string BytesText(uint64_t bytes);

// Seconds with three digits after the point, "1.234 s".
std::string SecondsText(double seconds);

}  // namespace deltaray

#endif  // CLIENT_TEXT_TABLE_H_
