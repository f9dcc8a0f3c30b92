// The lines of a text file, one after the other.

#ifndef SERVER_MESH_LINE_CURSOR_H_
#define SERVER_MESH_LINE_CURSOR_H_

#include <algorithm>
#include <cstdint>
#include <optional>

#include "absl/status/statusor.h"
#include "absl/strings/match.h"
#include "absl/strings/string_view.h"
#include "server/mesh/location.h"

namespace deltaray {

// Walks over lines that end in LF, CR LF or CR; the last one need not end. A byte order mark of UTF-8 at the front is
// passed over. Takes time in proportion to the bytes.
class LineCursor {
 public:
  LineCursor(absl::string_view text, uint64_t max_line_bytes)
      : text_(text), max_line_bytes_(max_line_bytes), position_(absl::StartsWith(text, "\xEF\xBB\xBF") ? 3 : 0) {}

  // Sets `line` to the next line without its end, and returns whether there was one. RESOURCE_EXHAUSTED for a line
  // longer than max_line_bytes.
  absl::StatusOr<bool> Next(absl::string_view* line) {
    if (position_ >= text_.size()) return false;
    ++line_number_;
    if (!line_feed_ || *line_feed_ < position_) line_feed_ = std::min(text_.find('\n', position_), text_.size());
    const absl::string_view rest = text_.substr(position_, *line_feed_ - position_);
    const size_t length = std::min(rest.find('\r'), rest.size());
    if (length > max_line_bytes_) {
      return OverLimit(where(), absl::StrCat("the line has ", length, " bytes"), "--max-line-bytes", max_line_bytes_);
    }
    *line = rest.substr(0, length);
    position_ += length;
    if (position_ < text_.size() && text_[position_] == '\r') ++position_;
    if (position_ < text_.size() && text_[position_] == '\n') ++position_;
    return true;
  }

  // The line that Next gave last; the first one before that.
  Location where() const { return Location::Line(std::max<uint64_t>(line_number_, 1)); }
  // Offset of the byte after the line that Next gave last, its end included.
  size_t position() const { return position_; }

 private:
  absl::string_view text_;
  uint64_t max_line_bytes_;
  uint64_t line_number_ = 0;
  size_t position_;
  std::optional<size_t> line_feed_;  // the first one at or after position_, or the end of the text
};

}  // namespace deltaray

#endif  // SERVER_MESH_LINE_CURSOR_H_
