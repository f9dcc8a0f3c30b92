#include "server/service/batch_query.h"

#include <cmath>
#include <limits>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace deltaray {
namespace {

using testing::HasSubstr;

std::string ErrorOf(const v1::RayQuery& query) {
  const absl::StatusOr<BatchQuery> read = ReadQuery(query);
  EXPECT_EQ(read.status().code(), absl::StatusCode::kInvalidArgument);
  return std::string(read.status().message());
}

uint32_t ColumnsByDefault(v1::QueryKind kind) {
  v1::RayQuery query;
  query.set_kind(kind);
  return ReadQuery(query)->columns;
}

TEST(BatchQueryTest, UnsetFieldsTakeTheDocumentedDefaults) {
  const absl::StatusOr<BatchQuery> query = ReadQuery(v1::RayQuery());
  ASSERT_TRUE(query.ok()) << query.status();
  EXPECT_EQ(query->kind, v1::QUERY_KIND_CLOSEST_HIT);
  EXPECT_EQ(query->RayBytes(), 24u);
  EXPECT_EQ(query->options.accuracy, AccuracyLevel::kExact);
  EXPECT_EQ(query->options.culling, Culling::kNone);
  EXPECT_EQ(query->options.max_hits_per_ray, 64u);
  EXPECT_EQ(query->t_min, 0);
  EXPECT_EQ(query->t_max, std::numeric_limits<float>::infinity());
  EXPECT_FALSE(query->wait_final);
}

TEST(BatchQueryTest, NoColumnsMeansAllButIdsOfFacesAndGroupsAndNormals) {
  constexpr uint32_t kHit =
      1u << v1::HIT_COLUMN_T | 1u << v1::HIT_COLUMN_PRIMITIVE_ID | 1u << v1::HIT_COLUMN_UV | 1u << v1::HIT_COLUMN_FLAGS;
  EXPECT_EQ(ColumnsByDefault(v1::QUERY_KIND_CLOSEST_HIT), kHit);
  EXPECT_EQ(ColumnsByDefault(v1::QUERY_KIND_ALL_HITS), kHit | 1u << v1::HIT_COLUMN_COUNT);
  EXPECT_EQ(ColumnsByDefault(v1::QUERY_KIND_ANY_HIT), 1u << v1::HIT_COLUMN_FLAGS);
  EXPECT_EQ(ColumnsByDefault(v1::QUERY_KIND_COUNT_HITS), 1u << v1::HIT_COLUMN_COUNT);
}

TEST(BatchQueryTest, ColumnsThatTheKindHasNotAreRefusedByName) {
  v1::RayQuery query;
  query.set_kind(v1::QUERY_KIND_ANY_HIT);
  query.add_columns(v1::HIT_COLUMN_FLAGS);
  query.add_columns(v1::HIT_COLUMN_T);
  EXPECT_EQ(ErrorOf(query), "query.columns[1]: QUERY_KIND_ANY_HIT has no HIT_COLUMN_T");

  query.clear_columns();
  query.set_kind(v1::QUERY_KIND_CLOSEST_HIT);
  query.add_columns(v1::HIT_COLUMN_COUNT);
  EXPECT_EQ(ErrorOf(query), "query.columns[0]: QUERY_KIND_CLOSEST_HIT has no HIT_COLUMN_COUNT");
}

TEST(BatchQueryTest, RepeatedAndUnknownColumnsAreRefused) {
  v1::RayQuery query;
  query.add_columns(v1::HIT_COLUMN_T);
  query.add_columns(v1::HIT_COLUMN_T);
  EXPECT_THAT(ErrorOf(query), HasSubstr("query.columns[1]: HIT_COLUMN_T stands there twice"));
  for (int column : {0, 9, 77, -1}) {
    query.clear_columns();
    query.mutable_columns()->Add(column);
    EXPECT_THAT(ErrorOf(query), HasSubstr("is not a column"));
  }
}

TEST(BatchQueryTest, UnknownValuesOfEnumsAreRefusedByField) {
  v1::RayQuery query;
  query.set_kind(static_cast<v1::QueryKind>(5));
  EXPECT_THAT(ErrorOf(query), HasSubstr("query.kind: 5"));
  query = v1::RayQuery();
  query.set_layout(static_cast<v1::RayLayout>(-1));
  EXPECT_THAT(ErrorOf(query), HasSubstr("query.layout: -1"));
  query = v1::RayQuery();
  query.set_accuracy(static_cast<v1::AccuracyLevel>(4));
  EXPECT_THAT(ErrorOf(query), HasSubstr("query.accuracy: 4"));
  query = v1::RayQuery();
  query.set_culling(static_cast<v1::Culling>(4));
  EXPECT_THAT(ErrorOf(query), HasSubstr("query.culling: 4"));
  query = v1::RayQuery();
  query.set_wait(static_cast<v1::BuildWait>(3));
  EXPECT_THAT(ErrorOf(query), HasSubstr("query.wait: 3"));
}

TEST(BatchQueryTest, IntervalMayBeInfiniteNotNaN) {
  v1::RayQuery query;
  query.set_t_min(-std::numeric_limits<float>::infinity());
  query.set_t_max(-1);
  ASSERT_TRUE(ReadQuery(query).ok());
  EXPECT_EQ(ReadQuery(query)->t_min, -std::numeric_limits<float>::infinity());
  EXPECT_EQ(ReadQuery(query)->t_max, -1);
  query.set_t_min(NAN);
  EXPECT_THAT(ErrorOf(query), HasSubstr("query.t_min: NaN"));
  query.set_t_min(0);
  query.set_t_max(NAN);
  EXPECT_THAT(ErrorOf(query), HasSubstr("query.t_max: NaN"));
}

TEST(BatchQueryTest, MaxHitsPerRayHasARange) {
  v1::RayQuery query;
  query.set_max_hits_per_ray(65'536);
  EXPECT_EQ(ReadQuery(query)->options.max_hits_per_ray, 65'536u);
  query.set_max_hits_per_ray(65'537);
  EXPECT_THAT(ErrorOf(query), HasSubstr("query.max_hits_per_ray: 65537 is not in the range 1 to 65536"));
}

}  // namespace
}  // namespace deltaray
