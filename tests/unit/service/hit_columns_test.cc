#include "server/service/hit_columns.h"

#include <limits>

#include "gtest/gtest.h"
#include "tests/unit/service/meshes.h"

namespace deltaray {
namespace {

constexpr float kInf = std::numeric_limits<float>::infinity();

BatchQuery Query(v1::QueryKind kind, std::initializer_list<v1::HitColumn> columns) {
  v1::RayQuery query;
  query.set_kind(kind);
  for (v1::HitColumn column : columns) query.add_columns(column);
  return *ReadQuery(query);
}

Hit MakeHit(float t, float u, float v, uint32_t primitive, bool back) {
  Hit hit;
  hit.t = t;
  hit.u = u;
  hit.v = v;
  hit.primitive = primitive;
  hit.back = back;
  return hit;
}

TEST(HitColumnsTest, WritesEachColumnToTheByte) {
  const BatchQuery query =
      Query(v1::QUERY_KIND_CLOSEST_HIT,
            {v1::HIT_COLUMN_T, v1::HIT_COLUMN_PRIMITIVE_ID, v1::HIT_COLUMN_FACE_ID, v1::HIT_COLUMN_GROUP_ID,
             v1::HIT_COLUMN_UV, v1::HIT_COLUMN_NORMAL, v1::HIT_COLUMN_FLAGS});
  const TriangleMesh mesh = Squares(2);
  v1::HitBatch batch;
  HitColumns columns(query, 3, 3, &batch);
  columns.WriteHits(1, std::vector<Hit>{Hit(), MakeHit(2.5f, 0.25f, 0.5f, 3, true)}, mesh);
  columns.WriteHits(0, std::vector<Hit>{MakeHit(1, 0, 1, 0, false)}, mesh);
  EXPECT_EQ(batch.t(), Bytes<float>({1, kInf, 2.5f}));
  EXPECT_EQ(batch.primitive_id(), Bytes<uint32_t>({0, 0xFFFFFFFF, 3}));
  EXPECT_EQ(batch.face_id(), Bytes<uint32_t>({0, 0xFFFFFFFF, 1}));
  EXPECT_EQ(batch.group_id(), Bytes<uint32_t>({0xFFFFFFFF, 0xFFFFFFFF, 0}));
  EXPECT_EQ(batch.uv(), Bytes<float>({0, 1, 0, 0, 0.25f, 0.5f}));
  EXPECT_EQ(batch.normal(), Bytes<float>({0, 0, 1, 0, 0, 0, 0, 0, 1}));
  EXPECT_EQ(batch.flags(), std::string({1, 0, 3}));
  EXPECT_TRUE(batch.count().empty());
  EXPECT_EQ(BytesPerHit(query), 37u);
  EXPECT_EQ(BytesPerRay(query), 37u);
}

TEST(HitColumnsTest, WritesNothingThatWasNotAskedFor) {
  v1::HitBatch batch;
  const BatchQuery query = Query(v1::QUERY_KIND_CLOSEST_HIT, {v1::HIT_COLUMN_PRIMITIVE_ID});
  HitColumns columns(query, 1, 1, &batch);
  columns.WriteHits(0, std::vector<Hit>{MakeHit(1, 0, 1, 1, true)}, Squares(1));
  v1::HitBatch expected;
  expected.set_primitive_id(Bytes<uint32_t>({1}));
  EXPECT_EQ(batch.SerializeAsString(), expected.SerializeAsString());
  EXPECT_EQ(BytesPerRay(query), 4u);
}

TEST(HitColumnsTest, WritesFlagsOfAnyHit) {
  v1::HitBatch batch;
  HitColumns columns(Query(v1::QUERY_KIND_ANY_HIT, {}), 3, 3, &batch);
  columns.WriteAny(0, std::vector<uint8_t>{1});
  columns.WriteAny(1, std::vector<uint8_t>{0, 1});
  EXPECT_EQ(batch.flags(), std::string({1, 0, 1}));
}

TEST(HitColumnsTest, CountsHaveARowPerRay) {
  const BatchQuery query = Query(v1::QUERY_KIND_ALL_HITS, {v1::HIT_COLUMN_COUNT, v1::HIT_COLUMN_FLAGS});
  v1::HitBatch batch;
  HitColumns columns(query, 2, 5, &batch);
  columns.WriteCounts(0, std::vector<uint32_t>{7, 9});
  EXPECT_EQ(batch.count(), Bytes<uint32_t>({7, 9}));
  EXPECT_EQ(batch.flags().size(), 5u);
  EXPECT_EQ(BytesPerHit(query), 1u);
  EXPECT_EQ(BytesPerRay(query), 8u);  // count and offset
}

TEST(HitColumnsTest, AppendsColumns) {
  v1::HitBatch a, b;
  a.set_t("12345678");
  b.set_t("abcd");
  b.set_flags("z");
  AppendColumns(b, &a);
  EXPECT_EQ(a.t(), "12345678abcd");
  EXPECT_EQ(a.flags(), "z");
}

}  // namespace
}  // namespace deltaray
