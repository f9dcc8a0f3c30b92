// The lines of a text file, one after the other.

#ifndef SERVER_MESH_LINE_CURSOR_H_
#define SERVER_MESH_LINE_CURSOR_H_

#include <algorithm>
#include <cstdint>
#include <cstring>

#include "absl/strings/string_view.h"
#include "server/mesh/location.h"

namespace deltaray {

// Walks over lines that end in LF, CR LF or CR; the last one need not end. Takes time in proportion to the bytes.
class LineCursor {
 public:
  LineCursor(absl::string_view text, uint64_t max_line_bytes) : text_(text), max_line_bytes_(max_line_bytes) {}

  // Sets `line` to the next line without its end, and returns whether there was one. RESOURCE_EXHAUSTED for a line
  // longer than max_line_bytes.
  absl::StatusOr<bool> Next(absl::string_view* line) {
    if (position_ >= text_.size()) return false;
    ++line_number_;
    if (line_feed_ <= position_ && position_ > 0) FindLineFeed();
    if (position_ == 0) FindLineFeed();
    const absl::string_view rest = text_.substr(position_, line_feed_ - position_);
    const size_t length = std::min(rest.find('\r'), rest.size());
    if (length > max_line_bytes_) {
      return OverLimit(where(), absl::StrCat("the line has ", length, " bytes"), "max_line_bytes", max_line_bytes_);
    }
    *line = rest.substr(0, length);
    position_ += length;
    if (position_ < text_.size() && text_[position_] == '\r') ++position_;
    if (position_ < text_.size() && text_[position_] == '\n') ++position_;
    return true;
  }

  // The line that Next gave last.
  Location where() const { return Location::Line(line_number_); }
  // Offset of the byte after the line that Next gave last, its end included.
  size_t position() const { return position_; }

 private:
  void FindLineFeed() { line_feed_ = std::min(text_.find('\n', position_), text_.size()); }

  absl::string_view text_;
  uint64_t max_line_bytes_;
  uint64_t line_number_ = 0;
  size_t position_ = 0;
  size_t line_feed_ = 0;  // of the first line feed at or after position_, or the end
};

}  // namespace deltaray

#endif  // SERVER_MESH_LINE_CURSOR_H_
