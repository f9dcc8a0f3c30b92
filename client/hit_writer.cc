#include "client/hit_writer.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "client/enum_names.h"
#include "client/exit_code.h"
#include "client/hit_column.h"
#include "client/output_file.h"

namespace deltaray {
namespace {

constexpr uint8_t kFlagHit = 1;
constexpr uint8_t kFlagBack = 2;

// Widths of table columns: the longest float32, "-1.17549435e-38", fits; rows stay aligned without knowing them all.
constexpr size_t kRayWidth = 10;
constexpr size_t kValueWidth = 15;

// A column of a batch: its bytes, and the bytes of one row.
struct Column {
  const std::string& bytes;
  size_t row_bytes;
};

Column ColumnOf(const v1::HitBatch& hits, v1::HitColumn column) {
  switch (column) {
    case v1::HIT_COLUMN_T:
      return {hits.t(), sizeof(float)};
    case v1::HIT_COLUMN_PRIMITIVE_ID:
      return {hits.primitive_id(), sizeof(uint32_t)};
    case v1::HIT_COLUMN_FACE_ID:
      return {hits.face_id(), sizeof(uint32_t)};
    case v1::HIT_COLUMN_GROUP_ID:
      return {hits.group_id(), sizeof(uint32_t)};
    case v1::HIT_COLUMN_UV:
      return {hits.uv(), 2 * sizeof(float)};
    case v1::HIT_COLUMN_NORMAL:
      return {hits.normal(), 3 * sizeof(float)};
    case v1::HIT_COLUMN_FLAGS:
      return {hits.flags(), sizeof(uint8_t)};
    default:
      return {hits.count(), sizeof(uint32_t)};
  }
}

// Names of the text columns of one column of the reply.
std::vector<std::string> TextNames(v1::HitColumn column, v1::QueryKind kind) {
  switch (column) {
    case v1::HIT_COLUMN_UV:
      return {"u", "v"};
    case v1::HIT_COLUMN_NORMAL:
      return {"nx", "ny", "nz"};
    case v1::HIT_COLUMN_FLAGS:
      if (kind == v1::QUERY_KIND_ANY_HIT) return {"hit"};
      return {"hit", "back"};
    default:
      return {EnumName(column)};
  }
}

// Builds one line in one of the text formats.
class TextRow {
 public:
  TextRow(HitFormat format, std::string* line) : format_(format), line_(line) {
    if (format_ == HitFormat::kJson) *line_ += '{';
  }

  void Add(absl::string_view name, absl::string_view value) {
    switch (format_) {
      case HitFormat::kJson:
        absl::StrAppend(line_, first_ ? "\"" : ",\"", name, "\":", value);
        break;
      case HitFormat::kTable: {
        const size_t width = first_ ? kRayWidth : kValueWidth;
        if (!first_) *line_ += ' ';
        line_->append(width - std::min(width, value.size()), ' ');
        absl::StrAppend(line_, value);
        break;
      }
      default:
        absl::StrAppend(line_, first_ ? "" : ",", value);
    }
    first_ = false;
  }

  void AddInteger(absl::string_view name, uint64_t value) { Add(name, absl::StrCat(value)); }

  void AddId(absl::string_view name, uint32_t id) {
    if (id == kNoId && format_ == HitFormat::kJson) {
      Add(name, "null");
    } else {
      AddInteger(name, id);
    }
  }

  void AddFloat(absl::string_view name, float value) {
    if (!std::isfinite(value) && format_ == HitFormat::kJson) return Add(name, "null");
    char text[32];
    Add(name, absl::string_view(text, std::to_chars(text, text + sizeof(text), value).ptr - text));
  }

  void AddFlag(absl::string_view name, bool value) {
    if (format_ == HitFormat::kJson) {
      Add(name, value ? "true" : "false");
    } else {
      Add(name, value ? "1" : "0");
    }
  }

  void End() { *line_ += format_ == HitFormat::kJson ? "}\n" : "\n"; }

 private:
  const HitFormat format_;
  std::string* const line_;
  bool first_ = true;
};

bool KindHas(v1::QueryKind kind, v1::HitColumn column) {
  switch (kind) {
    case v1::QUERY_KIND_ANY_HIT:
      return column == v1::HIT_COLUMN_FLAGS;
    case v1::QUERY_KIND_COUNT_HITS:
      return column == v1::HIT_COLUMN_COUNT;
    case v1::QUERY_KIND_ALL_HITS:
      return true;
    default:
      return column != v1::HIT_COLUMN_COUNT;
  }
}

bool InDefault(v1::HitColumn column) {
  return column != v1::HIT_COLUMN_FACE_ID && column != v1::HIT_COLUMN_GROUP_ID && column != v1::HIT_COLUMN_NORMAL;
}

}  // namespace

absl::StatusOr<std::vector<v1::HitColumn>> ResolveColumns(v1::QueryKind kind, const std::vector<v1::HitColumn>& asked) {
  for (const v1::HitColumn column : asked) {
    if (!KindHas(kind, column)) {
      return UsageError(absl::StrCat("--columns: ", EnumName(column), " is not a column of ", EnumName(kind)));
    }
    if (std::count(asked.begin(), asked.end(), column) > 1) {
      return UsageError(absl::StrCat("--columns: ", EnumName(column), " stands twice"));
    }
  }
  std::vector<v1::HitColumn> columns = asked;
  for (int i = v1::HIT_COLUMN_T; asked.empty() && i <= v1::HIT_COLUMN_COUNT; ++i) {
    const auto column = static_cast<v1::HitColumn>(i);
    if (KindHas(kind, column) && InDefault(column)) columns.push_back(column);
  }
  std::sort(columns.begin(), columns.end());
  return columns;
}

void HitWriter::AppendHeader() {
  if (std::exchange(begun_, true) || format_ == HitFormat::kJson || format_ == HitFormat::kRaw) return;
  TextRow header(format_, &buffer_);
  header.Add("", "ray");
  for (const v1::HitColumn column : columns_) {
    for (const std::string& name : TextNames(column, kind_)) header.Add("", name);
  }
  header.End();
}

absl::Status HitWriter::Flush() {
  absl::Status status = WriteOutput(output_, buffer_);
  buffer_.clear();
  return status;
}

absl::Status HitWriter::Write(const v1::HitBatch& hits) {
  absl::Status status = Check(hits);
  if (!status.ok()) return status;
  AppendHeader();
  const bool all_hits = kind_ == v1::QUERY_KIND_ALL_HITS;
  for (uint32_t i = 0; i < hits.ray_count(); ++i) {
    const size_t begin = all_hits ? RowAt<uint32_t>(hits.offsets(), i) : i;
    const size_t end = all_hits ? RowAt<uint32_t>(hits.offsets(), i + 1) : i + 1;
    for (size_t row = begin; row < end; ++row) AppendRow(hits, i, row);
  }
  next_ray_ += hits.ray_count();
  return Flush();
}

absl::Status HitWriter::End() {
  AppendHeader();
  return Flush();
}

absl::Status HitWriter::Check(const v1::HitBatch& hits) const {
  const uint64_t rays = hits.ray_count();
  uint64_t rows = rays;
  if (kind_ == v1::QUERY_KIND_ALL_HITS) {
    if (hits.offsets().size() != (rays + 1) * sizeof(uint32_t)) {
      return LocalError(
          absl::StrCat("the server's reply has ", hits.offsets().size(), " bytes of offsets for ", rays, " rays"));
    }
    uint32_t last = 0;
    for (uint64_t i = 0; i <= rays; ++i) {
      const uint32_t offset = RowAt<uint32_t>(hits.offsets(), i);
      if (offset < last || (i == 0 && offset != 0)) {
        return LocalError(absl::StrCat("the server's reply has offset ", offset, " at ", i, ", after ", last));
      }
      last = offset;
    }
    rows = last;
  }
  for (const v1::HitColumn column : columns_) {
    const auto [bytes, row_bytes] = ColumnOf(hits, column);
    const uint64_t expected = column == v1::HIT_COLUMN_COUNT ? rays : rows;
    if (bytes.size() != expected * row_bytes) {
      return LocalError(absl::StrCat("the server's reply has ", bytes.size(), " bytes of ", EnumName(column), " for ",
                                     expected, column == v1::HIT_COLUMN_COUNT ? " rays" : " rows"));
    }
  }
  return absl::OkStatus();
}

void HitWriter::AppendRow(const v1::HitBatch& hits, uint32_t ray, size_t row) {
  if (format_ != HitFormat::kRaw) return AppendTextRow(hits, ray, row);
  if (kind_ == v1::QUERY_KIND_ALL_HITS) {
    const uint64_t number = next_ray_ + ray;
    buffer_.append(reinterpret_cast<const char*>(&number), sizeof(number));
  }
  for (const v1::HitColumn column : columns_) {
    const auto [bytes, row_bytes] = ColumnOf(hits, column);
    buffer_.append(bytes, (column == v1::HIT_COLUMN_COUNT ? ray : row) * row_bytes, row_bytes);
  }
}

void HitWriter::AppendTextRow(const v1::HitBatch& hits, uint32_t ray, size_t row) {
  TextRow line(format_, &buffer_);
  line.AddInteger("ray", next_ray_ + ray);
  for (const v1::HitColumn column : columns_) {
    const std::string& bytes = ColumnOf(hits, column).bytes;
    switch (column) {
      case v1::HIT_COLUMN_T:
        line.AddFloat("t", RowAt<float>(bytes, row));
        break;
      case v1::HIT_COLUMN_PRIMITIVE_ID:
        line.AddId("primitive_id", RowAt<uint32_t>(bytes, row));
        break;
      case v1::HIT_COLUMN_FACE_ID:
        line.AddId("face_id", RowAt<uint32_t>(bytes, row));
        break;
      case v1::HIT_COLUMN_GROUP_ID:
        line.AddId("group_id", RowAt<uint32_t>(bytes, row));
        break;
      case v1::HIT_COLUMN_UV:
        line.AddFloat("u", RowAt<float>(bytes, 2 * row));
        line.AddFloat("v", RowAt<float>(bytes, 2 * row + 1));
        break;
      case v1::HIT_COLUMN_NORMAL:
        line.AddFloat("nx", RowAt<float>(bytes, 3 * row));
        line.AddFloat("ny", RowAt<float>(bytes, 3 * row + 1));
        line.AddFloat("nz", RowAt<float>(bytes, 3 * row + 2));
        break;
      case v1::HIT_COLUMN_FLAGS:
        line.AddFlag("hit", RowAt<uint8_t>(bytes, row) & kFlagHit);
        if (kind_ != v1::QUERY_KIND_ANY_HIT) line.AddFlag("back", RowAt<uint8_t>(bytes, row) & kFlagBack);
        break;
      default:
        line.AddInteger("count", RowAt<uint32_t>(bytes, ray));
    }
  }
  line.End();
}

}  // namespace deltaray
