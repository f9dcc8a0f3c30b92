#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/string_view.h"
#include "absl/strings/strip.h"
#include "client/exit_code.h"
#include "client/ray_reader.h"

namespace deltaray {
namespace {

constexpr std::array<absl::string_view, 8> kColumns = {"ox", "oy", "oz", "dx", "dy", "dz", "t_min", "t_max"};
constexpr size_t kRequiredColumns = 6;
constexpr size_t kMaxLineBytes = 4095;
// What some programs of Windows write before the first line.
constexpr absl::string_view kByteOrderMark = "\xEF\xBB\xBF";

// What stands in a field, for an error: at most so much of it as a number may take, and nothing that is not ASCII,
// since it may be anything where the file is none of text.
std::string Quoted(absl::string_view field) {
  constexpr size_t kMost = 40;
  return absl::StrCat("'", absl::CHexEscape(field.substr(0, kMost)), field.size() > kMost ? "…'" : "'");
}

bool IsControl(char c) { return static_cast<unsigned char>(c) < 0x20 && c != '\t' && c != '\r' && c != '\n'; }
bool IsBeyondAscii(char c) { return static_cast<unsigned char>(c) > 0x7e; }

// Lines of a file, through a buffer of fixed size.
class LineReader {
 public:
  explicit LineReader(InputFile file) : file_(std::move(file)), buffer_(1 << 16) {}

  // The next line without its end, valid until the next call; nullopt at the end of the file.
  absl::StatusOr<std::optional<absl::string_view>> Next() {
    ++number_;
    while (true) {
      const absl::string_view unread(buffer_.data() + begin_, end_ - begin_);
      const size_t length = unread.find('\n');
      if (length > kMaxLineBytes && (length != unread.npos || unread.size() > kMaxLineBytes)) {
        line_ = unread;
        return Error(absl::StrCat("is longer than ", kMaxLineBytes, " bytes"));
      }
      if (length != unread.npos || (ended_ && !unread.empty())) {
        absl::string_view line = unread.substr(0, length);
        begin_ += line.size() + (length != unread.npos ? 1 : 0);
        absl::ConsumeSuffix(&line, "\r");
        if (number_ == 1) absl::ConsumePrefix(&line, kByteOrderMark);
        line_ = line;
        return line;
      }
      if (ended_) return std::nullopt;
      // Move what is left to the front, and read on behind it.
      std::copy(buffer_.begin() + begin_, buffer_.begin() + end_, buffer_.begin());
      end_ -= begin_;
      begin_ = 0;
      const absl::StatusOr<size_t> count = file_.ReadSome(std::span(buffer_).subspan(end_));
      if (!count.ok()) return count.status();
      end_ += *count;
      ended_ = *count == 0;
    }
  }

  // An error in the line that Next() returned last.
  absl::Status Error(absl::string_view what) const {
    return LocalError(absl::StrCat(file_.name(), ": line ", number_, ": ", what,
                                   LooksBinary() ? "; is it binary? see --rays-format" : ""));
  }

 private:
  // Letters beyond ASCII in later lines are a slip in a file of text.
  bool LooksBinary() const {
    return std::any_of(line_.begin(), line_.end(), IsControl) ||
           (number_ == 1 && std::any_of(line_.begin(), line_.end(), IsBeyondAscii));
  }

  InputFile file_;
  std::vector<char> buffer_;
  size_t begin_ = 0;
  size_t end_ = 0;
  bool ended_ = false;
  uint64_t number_ = 0;
  absl::string_view line_;  // as for Next(), or the part that is read of one that is too long
};

// The whole of `text` as a number; a leading '+', "inf" and "nan" are taken, numbers too large for a double are not.
std::optional<double> ParseNumber(absl::string_view text) {
  if (!absl::StartsWith(text, "+-")) absl::ConsumePrefix(&text, "+");
  double value;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (end != text.data() + text.size() || error == std::errc::invalid_argument) return std::nullopt;
  if (error == std::errc::result_out_of_range) {
    // Too large, or so small that it rounds to zero; only strtod tells which.
    value = std::strtod(std::string(text).c_str(), nullptr);
    if (std::isinf(value)) return std::nullopt;
  }
  return value;
}

class CsvRayReader : public RayReader {
 public:
  explicit CsvRayReader(InputFile file) : lines_(std::move(file)) {}

  // Reads the first line that counts: the header, or the first ray.
  absl::Status ReadHeader() {
    absl::Status status = NextFields();
    if (!status.ok() || fields_.empty()) return status;
    if (ParseNumber(fields_[0])) {
      if (fields_.size() != kRequiredColumns && fields_.size() != kColumns.size()) {
        return lines_.Error(
            absl::StrCat("has ", fields_.size(), " columns; a ray has 6 or 8: ", absl::StrJoin(kColumns, ",")));
      }
      for (size_t i = 0; i < fields_.size(); ++i) column_of_field_.push_back(i);
      first_ray_pending_ = true;
      return absl::OkStatus();
    }
    return ReadColumnNames();
  }

  v1::RayLayout layout() const override {
    return column_of_field_.size() == kColumns.size() ? v1::RAY_LAYOUT_FLOAT64X8 : v1::RAY_LAYOUT_FLOAT64X6;
  }

  absl::StatusOr<size_t> Read(size_t limit, std::string* rays) override {
    for (size_t count = 0; count < limit; ++count) {
      if (!first_ray_pending_) {
        absl::Status status = NextFields();
        if (!status.ok()) return status;
      }
      first_ray_pending_ = false;
      if (fields_.empty()) return count;
      absl::Status status = AppendRay(rays);
      if (!status.ok()) return status;
    }
    return limit;
  }

 private:
  // Splits the next line that is neither empty nor a comment into `fields_`; leaves it empty at the end of the file.
  absl::Status NextFields() {
    fields_.clear();
    while (true) {
      const auto line = lines_.Next();
      if (!line.ok()) return line.status();
      if (!line->has_value()) return absl::OkStatus();
      const absl::string_view text = absl::StripAsciiWhitespace(**line);
      if (text.empty() || text[0] == '#') continue;
      for (const absl::string_view field : absl::StrSplit(text, ',')) {
        fields_.push_back(absl::StripAsciiWhitespace(field));
      }
      return absl::OkStatus();
    }
  }

  absl::Status ReadColumnNames() {
    std::array<bool, kColumns.size()> seen = {};
    for (const absl::string_view field : fields_) {
      const size_t column = std::find(kColumns.begin(), kColumns.end(), field) - kColumns.begin();
      if (column == kColumns.size()) {
        return lines_.Error(absl::StrCat(Quoted(field), " is neither a number nor a column; columns are ",
                                         absl::StrJoin(kColumns, ",")));
      }
      if (std::exchange(seen[column], true)) return lines_.Error(absl::StrCat("column ", field, " stands twice"));
      column_of_field_.push_back(column);
    }
    // t_min and t_max come together or not at all.
    const bool interval = seen[6] || seen[7];
    for (size_t i = 0; i < (interval ? kColumns.size() : kRequiredColumns); ++i) {
      if (!seen[i]) return lines_.Error(absl::StrCat("column ", kColumns[i], " is missing"));
    }
    return absl::OkStatus();
  }

  absl::Status AppendRay(std::string* rays) {
    if (fields_.size() != column_of_field_.size()) {
      return lines_.Error(absl::StrCat("has ", fields_.size(), " fields, not ", column_of_field_.size()));
    }
    std::array<double, kColumns.size()> ray;
    for (size_t i = 0; i < fields_.size(); ++i) {
      const size_t column = column_of_field_[i];
      const std::optional<double> value = ParseNumber(fields_[i]);
      const bool allowed = value && (column < kRequiredColumns ? std::isfinite(*value) : !std::isnan(*value));
      if (!allowed) {
        return lines_.Error(absl::StrCat("column ", kColumns[column], ": ", Quoted(fields_[i]), " is not a ",
                                         column < kRequiredColumns ? "finite number" : "number"));
      }
      ray[column] = *value;
    }
    rays->append(reinterpret_cast<const char*>(ray.data()), fields_.size() * sizeof(double));
    return absl::OkStatus();
  }

  LineReader lines_;
  // Fields of the current line; views into the buffer of `lines_`.
  std::vector<absl::string_view> fields_;
  // Entry i is the column that field i of each line holds.
  std::vector<size_t> column_of_field_;
  bool first_ray_pending_ = false;
};

}  // namespace

absl::StatusOr<std::unique_ptr<RayReader>> OpenCsvRays(InputFile file) {
  auto reader = std::make_unique<CsvRayReader>(std::move(file));
  absl::Status status = reader->ReadHeader();
  if (!status.ok()) return status;
  return reader;
}

}  // namespace deltaray
