#include "server/mesh/obj_reader.h"

#define TINYOBJLOADER_IMPLEMENTATION
#define TINYOBJLOADER_USE_DOUBLE
#include <tiny_obj_loader.h>

#include <algorithm>
#include <array>
#include <istream>
#include <map>
#include <streambuf>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/strip.h"
#include "server/mesh/line_cursor.h"
#include "server/mesh/number.h"

namespace deltaray {
namespace {

// What a mesh of triangles has no use for, and no reader misses.
constexpr std::array<absl::string_view, 13> kIgnored = {"vn",       "vt",       "s",    "usemtl",     "mtllib",
                                                        "usemap",   "maplib",   "mg",   "shadow_obj", "trace_obj",
                                                        "c_interp", "d_interp", "bevel"};
// Geometry other than faces, and what belongs to it. Passed over with a warning.
constexpr std::array<absl::string_view, 24> kSkipped = {
    "p",    "l",    "curv", "curv2", "surf", "vp",    "cstype", "deg", "bmat", "step", "parm", "trim",
    "hole", "scrv", "sp",   "end",   "con",  "ctech", "stech",  "lod", "call", "csh",  "bzp",  "bsp"};

template <size_t N>
bool Contains(const std::array<absl::string_view, N>& words, absl::string_view word) {
  return std::find(words.begin(), words.end(), word) != words.end();
}

// Geometry that is read.
constexpr std::array<absl::string_view, 5> kRead = {"v", "f", "fo", "g", "o"};

// Whether tinyobjloader reads `corner` right: "1", "-1", "1/2", "1//3", "1/2/3" and the like, each within an int.
bool IsCorner(absl::string_view corner) {
  for (int part = 0;; ++part) {
    const size_t slash = corner.find('/');
    const absl::string_view number = corner.substr(0, slash);
    int index;
    if (!(part > 0 && number.empty()) && !ParseInteger(number, &index)) return false;
    if (slash == absl::string_view::npos) return true;
    if (part == 2) return false;
    corner.remove_prefix(slash + 1);
  }
}

// Hands tinyobjloader the file line by line, and only lines that it reads right: faces and groups that are well formed.
// Vertices are read here, since its decimal conversion is not rounded right and takes "nan" for 0. Its callbacks come
// before it asks for the next line, so that errors in them know their line too.
class StatementFilter : public std::streambuf {
 public:
  StatementFilter(absl::string_view text, FaceCollector* collector)
      : lines_(text, collector->limits().max_line_bytes), collector_(*collector) {}

  // The first error, in a line or in a callback.
  const absl::Status& status() const { return status_; }
  void WarnOfSkipped();
  Location where() const { return lines_.where(); }

  void AddFace(const tinyobj::index_t* indices, int count);
  void SetGroup(absl::string_view name) { Update(collector_.SetGroup(name, statement_)); }

 private:
  int_type underflow() override;
  // Reads lines up to one that is for tinyobjloader, which is then in buffer_. False at the end of the file.
  absl::StatusOr<bool> Advance();
  // Sets `line` to the next statement, whose continuation lines are joined. False at the end of the file.
  absl::StatusOr<bool> NextStatement(absl::string_view* line);
  absl::Status AddVertex(absl::string_view numbers);
  absl::Status CheckFace(absl::string_view corners);
  void Update(absl::Status status) {
    if (status_.ok()) status_ = std::move(status);
  }

  struct Skipped {
    uint64_t count = 0;
    Location first;
  };

  LineCursor lines_;
  FaceCollector& collector_;
  absl::Status status_;
  Location statement_;  // where the current statement begins
  std::string joined_;  // the current statement, where it has more than one line
  std::string buffer_;
  std::vector<uint32_t> corners_;
  std::map<std::string, Skipped> skipped_;
  Skipped weights_;  // vertices with a w other than 1
};

StatementFilter::int_type StatementFilter::underflow() {
  if (!status_.ok()) return traits_type::eof();
  const absl::StatusOr<bool> more = Advance();
  Update(more.status());
  if (!more.ok() || !*more) return traits_type::eof();
  setg(buffer_.data(), buffer_.data(), buffer_.data() + buffer_.size());
  return traits_type::to_int_type(buffer_[0]);
}

absl::StatusOr<bool> StatementFilter::Advance() {
  absl::string_view line;
  while (true) {
    const absl::StatusOr<bool> more = NextStatement(&line);
    if (!more.ok() || !*more) return more;
    if (absl::Status status = collector_.Poll(); !status.ok()) return status;
    absl::string_view rest = line;
    const absl::string_view keyword = NextToken(&rest);
    if (keyword == "v") {
      if (absl::Status status = AddVertex(rest.substr(0, rest.find('#'))); !status.ok()) return status;
    } else if (keyword == "f" || keyword == "fo") {
      rest = rest.substr(0, rest.find('#'));
      if (absl::Status status = CheckFace(rest); !status.ok()) return status;
      buffer_ = absl::StrCat("f ", rest, "\n");
      return true;
    } else if (keyword == "g" || keyword == "o") {
      buffer_ = absl::StrCat(keyword, " ", absl::StripAsciiWhitespace(rest), "\n");
      return true;
    } else if (Contains(kSkipped, keyword)) {
      Skipped& skipped = skipped_[std::string(keyword)];
      if (skipped.count++ == 0) skipped.first = statement_;
    } else if (!Contains(kIgnored, keyword)) {
      return Malformed(statement_, Quoted(keyword), " is not a statement of OBJ");
    }
  }
}

absl::StatusOr<bool> StatementFilter::NextStatement(absl::string_view* line) {
  while (true) {
    absl::StatusOr<bool> more = lines_.Next(line);
    if (!more.ok() || !*more) return more;
    statement_ = lines_.where();
    *line = absl::StripLeadingAsciiWhitespace(*line);
    if (line->empty() || line->front() == '#') continue;
    if (line->back() != '\\') return true;
    joined_.clear();
    while (absl::ConsumeSuffix(line, "\\")) {
      absl::StrAppend(&joined_, *line, " ");
      if (joined_.size() > collector_.limits().max_line_bytes) {
        return OverLimit(statement_, "the line with its continuation lines is too long", "--max-line-bytes",
                         collector_.limits().max_line_bytes);
      }
      more = lines_.Next(line);
      if (!more.ok()) return more;
      if (!*more) *line = "";
    }
    absl::StrAppend(&joined_, *line);
    *line = joined_;
    return true;
  }
}

absl::Status StatementFilter::AddVertex(absl::string_view numbers) {
  double values[8];
  size_t count = 0;
  for (absl::string_view token = NextToken(&numbers); !token.empty(); token = NextToken(&numbers)) {
    if (count == 8) return Malformed(statement_, "a vertex has more than 8 numbers");
    if (!ParseDouble(token, &values[count++])) {
      return Malformed(statement_, Quoted(token), " is not a number, as number ", count, " of a vertex");
    }
  }
  if (count < 3) return Malformed(statement_, "a vertex needs 3 coordinates and has ", count);
  // Numbers past the third are a weight w, or a colour.
  if (count == 4 && values[3] != 1 && weights_.count++ == 0) weights_.first = statement_;
  return collector_.AddVertex({values[0], values[1], values[2]}, statement_);
}

absl::Status StatementFilter::CheckFace(absl::string_view corners) {
  absl::string_view token = NextToken(&corners);
  // tinyobjloader would pass over a face without corners.
  if (token.empty()) return collector_.AddFace({}, statement_);
  for (; !token.empty(); token = NextToken(&corners)) {
    if (!IsCorner(token)) return Malformed(statement_, Quoted(token), " is not a corner of a face");
  }
  return absl::OkStatus();
}

void StatementFilter::AddFace(const tinyobj::index_t* indices, int count) {
  corners_.clear();
  const int64_t vertex_count = collector_.vertex_count();
  for (int i = 0; i < count; ++i) {
    const int64_t index = indices[i].vertex_index;
    if (index == 0) return Update(Malformed(statement_, "a face names vertex 0; OBJ counts from 1"));
    if (index < -vertex_count) {
      return Update(
          Malformed(statement_, "a face names vertex ", index, ", but ", vertex_count, " vertices stand before it"));
    }
    corners_.push_back(index > 0 ? index - 1 : vertex_count + index);
  }
  Update(collector_.AddFace(corners_, statement_));
}

void StatementFilter::WarnOfSkipped() {
  for (const auto& [keyword, skipped] : skipped_) {
    collector_.Warn(absl::StrCat(skipped.count, " statements \"", keyword, "\" are passed over, the first in ",
                                 skipped.first.ToString(), "; only faces are read."));
  }
  if (weights_.count > 0) {
    collector_.Warn(absl::StrCat(weights_.count, " vertices have a weight w other than 1, the first in ",
                                 weights_.first.ToString(), "; w is passed over."));
  }
}

}  // namespace

bool IsObjStatement(absl::string_view line) {
  const absl::string_view keyword = NextToken(&line);
  return Contains(kRead, keyword) || Contains(kIgnored, keyword) || Contains(kSkipped, keyword);
}

absl::Status ReadObj(absl::string_view text, FaceCollector* collector) {
  StatementFilter filter(text, collector);
  std::istream stream(&filter);
  stream.exceptions(std::ios::badbit);  // Else the stream would swallow std::bad_alloc, and the file end early.

  tinyobj::callback_t callbacks;
  callbacks.index_cb = [](void* filter, tinyobj::index_t* indices, int count) {
    static_cast<StatementFilter*>(filter)->AddFace(indices, count);
  };
  callbacks.group_cb = [](void* filter, const char** names, int count) {
    static_cast<StatementFilter*>(filter)->SetGroup(absl::StrJoin(names, names + count, " "));
  };
  callbacks.object_cb = [](void* filter, const char* name) { static_cast<StatementFilter*>(filter)->SetGroup(name); };
  // Without a material reader, `mtllib` opens nothing.
  tinyobj::LoadObjWithCallback(stream, callbacks, &filter, /*readMatFn=*/nullptr, nullptr, nullptr);
  if (!filter.status().ok()) return filter.status();

  if (collector->vertex_count() == 0) return Malformed(filter.where(), "the file ends without any vertex");
  filter.WarnOfSkipped();
  return absl::OkStatus();
}

}  // namespace deltaray
