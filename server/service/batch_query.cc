#include "server/service/batch_query.h"

#include <cmath>
#include <initializer_list>
#include <limits>
#include <string>

#include "absl/strings/str_cat.h"

namespace deltaray {
namespace {

constexpr uint32_t kMaxHitsPerRay = 65'536;

constexpr uint32_t Columns(std::initializer_list<v1::HitColumn> columns) {
  uint32_t bits = 0;
  for (v1::HitColumn column : columns) bits |= uint32_t{1} << column;
  return bits;
}

constexpr uint32_t kDefaultHitColumns =
    Columns({v1::HIT_COLUMN_T, v1::HIT_COLUMN_PRIMITIVE_ID, v1::HIT_COLUMN_UV, v1::HIT_COLUMN_FLAGS});
constexpr uint32_t kHitColumns =
    kDefaultHitColumns | Columns({v1::HIT_COLUMN_FACE_ID, v1::HIT_COLUMN_GROUP_ID, v1::HIT_COLUMN_NORMAL});

struct KindColumns {
  uint32_t allowed;
  uint32_t by_default;
};

KindColumns ColumnsOf(v1::QueryKind kind) {
  switch (kind) {
    case v1::QUERY_KIND_ANY_HIT:
      return {Columns({v1::HIT_COLUMN_FLAGS}), Columns({v1::HIT_COLUMN_FLAGS})};
    case v1::QUERY_KIND_COUNT_HITS:
      return {Columns({v1::HIT_COLUMN_COUNT}), Columns({v1::HIT_COLUMN_COUNT})};
    case v1::QUERY_KIND_ALL_HITS:
      return {kHitColumns | Columns({v1::HIT_COLUMN_COUNT}), kDefaultHitColumns | Columns({v1::HIT_COLUMN_COUNT})};
    default:
      return {kHitColumns, kDefaultHitColumns};
  }
}

// Reads the value of an enum field; *result stays as it is for the unspecified one, 0.
template <typename Enum>
absl::Status ReadEnum(int value, bool (*is_valid)(int), const char* field, Enum* result) {
  if (!is_valid(value)) {
    return absl::InvalidArgumentError(absl::StrCat("query.", field, ": ", value, " is not a value of the enum"));
  }
  if (value != 0) *result = static_cast<Enum>(value);
  return absl::OkStatus();
}

absl::Status ReadColumns(const v1::RayQuery& query, v1::QueryKind kind, uint32_t* columns) {
  const KindColumns kind_columns = ColumnsOf(kind);
  *columns = 0;
  for (int i = 0; i < query.columns_size(); ++i) {
    const int column = query.columns(i);
    const std::string where = absl::StrCat("query.columns[", i, "]: ");
    if (!v1::HitColumn_IsValid(column) || column == v1::HIT_COLUMN_UNSPECIFIED) {
      return absl::InvalidArgumentError(absl::StrCat(where, column, " is not a column"));
    }
    const uint32_t bit = uint32_t{1} << column;
    const std::string& name = v1::HitColumn_Name(static_cast<v1::HitColumn>(column));
    if ((kind_columns.allowed & bit) == 0) {
      return absl::InvalidArgumentError(absl::StrCat(where, v1::QueryKind_Name(kind), " has no ", name));
    }
    if ((*columns & bit) != 0) return absl::InvalidArgumentError(absl::StrCat(where, name, " stands there twice"));
    *columns |= bit;
  }
  if (*columns == 0) *columns = kind_columns.by_default;
  return absl::OkStatus();
}

}  // namespace

size_t BatchQuery::RayBytes() const {
  switch (layout) {
    case v1::RAY_LAYOUT_FLOAT32X8:
      return 32;
    case v1::RAY_LAYOUT_FLOAT64X6:
      return 48;
    case v1::RAY_LAYOUT_FLOAT64X8:
      return 64;
    default:
      return 24;
  }
}

absl::StatusOr<BatchQuery> ReadQuery(const v1::RayQuery& query) {
  BatchQuery result;
  v1::AccuracyLevel accuracy = v1::ACCURACY_LEVEL_EXACT;
  v1::Culling culling = v1::CULLING_NONE;
  v1::BuildWait wait = v1::BUILD_WAIT_PROVISIONAL;
  for (const absl::Status& status : {ReadEnum(query.kind(), v1::QueryKind_IsValid, "kind", &result.kind),
                                     ReadEnum(query.layout(), v1::RayLayout_IsValid, "layout", &result.layout),
                                     ReadEnum(query.accuracy(), v1::AccuracyLevel_IsValid, "accuracy", &accuracy),
                                     ReadEnum(query.culling(), v1::Culling_IsValid, "culling", &culling),
                                     ReadEnum(query.wait(), v1::BuildWait_IsValid, "wait", &wait)}) {
    if (!status.ok()) return status;
  }
  if (absl::Status status = ReadColumns(query, result.kind, &result.columns); !status.ok()) return status;

  result.options.accuracy = static_cast<AccuracyLevel>(accuracy);
  result.options.culling = culling == v1::CULLING_BACK    ? Culling::kBack
                           : culling == v1::CULLING_FRONT ? Culling::kFront
                                                          : Culling::kNone;
  result.wait_final = wait == v1::BUILD_WAIT_FINAL;

  if (query.max_hits_per_ray() > kMaxHitsPerRay) {
    return absl::InvalidArgumentError(absl::StrCat("query.max_hits_per_ray: ", query.max_hits_per_ray(),
                                                   " is not in the range 1 to ", kMaxHitsPerRay, ", nor 0"));
  }
  if (query.max_hits_per_ray() != 0) result.options.max_hits_per_ray = query.max_hits_per_ray();

  result.t_min = query.t_min();
  result.t_max = query.has_t_max() ? query.t_max() : std::numeric_limits<float>::infinity();
  if (std::isnan(result.t_min)) return absl::InvalidArgumentError("query.t_min: NaN is not a number");
  if (std::isnan(result.t_max)) return absl::InvalidArgumentError("query.t_max: NaN is not a number");
  return result;
}

}  // namespace deltaray
