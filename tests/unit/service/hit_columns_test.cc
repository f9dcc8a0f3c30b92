#include "server/service/hit_columns.h"

#include <limits>

#include "gtest/gtest.h"
#include "tests/unit/service/meshes.h"

namespace deltaray {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

BatchQuery Query(v1::QueryKind kind, std::initializer_list<v1::HitColumn> columns) {
  v1::RayQuery query;
  query.set_kind(kind);
  for (v1::HitColumn column : columns) query.add_columns(column);
  return *ReadQuery(query);
}

constexpr HitColumns::Summary kSummary = {AccuracyLevel::kExact, true};

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
  HitColumns columns(query, 3, 3, kSummary);
  columns.WriteHits(1, std::vector<Hit>{Hit(), MakeHit(2.5f, 0.25f, 0.5f, 3, true)}, mesh);
  columns.WriteHits(0, std::vector<Hit>{MakeHit(1, 0, 1, 0, false)}, mesh);
  const v1::HitBatch batch = ToHitBatch(columns.Take());
  EXPECT_EQ(batch.t(), Bytes<float>({1, kInfinity, 2.5f}));
  EXPECT_EQ(batch.primitive_id(), Bytes<uint32_t>({0, 0xFFFFFFFF, 3}));
  EXPECT_EQ(batch.face_id(), Bytes<uint32_t>({0, 0xFFFFFFFF, 1}));
  EXPECT_EQ(batch.group_id(), Bytes<uint32_t>({0xFFFFFFFF, 0xFFFFFFFF, 0}));
  EXPECT_EQ(batch.uv(), Bytes<float>({0, 1, 0, 0, 0.25f, 0.5f}));
  EXPECT_EQ(batch.normal(), Bytes<float>({0, 0, 1, 0, 0, 0, 0, 0, 1}));
  EXPECT_EQ(batch.flags(), std::string({1, 0, 3}));
  EXPECT_TRUE(batch.count().empty());
  EXPECT_EQ(batch.ray_count(), 3u);
  EXPECT_EQ(batch.accuracy(), v1::ACCURACY_LEVEL_EXACT);
  EXPECT_TRUE(batch.final_tree());
  EXPECT_EQ(BytesPerHit(query), 37u);
  EXPECT_EQ(BytesPerRay(query), 37u);
}

TEST(HitColumnsTest, WritesNothingThatWasNotAskedFor) {
  const BatchQuery query = Query(v1::QUERY_KIND_CLOSEST_HIT, {v1::HIT_COLUMN_PRIMITIVE_ID});
  HitColumns columns(query, 1, 1, {AccuracyLevel::kFast, false});
  columns.WriteHits(0, std::vector<Hit>{MakeHit(1, 0, 1, 1, true)}, Squares(1));
  v1::HitBatch expected;
  expected.set_primitive_id(Bytes<uint32_t>({1}));
  expected.set_ray_count(1);
  expected.set_accuracy(v1::ACCURACY_LEVEL_FAST);
  EXPECT_EQ(ToHitBatch(columns.Take()).SerializeAsString(), expected.SerializeAsString());
  EXPECT_EQ(BytesPerRay(query), 4u);
}

TEST(HitColumnsTest, WritesFlagsOfAnyHit) {
  HitColumns columns(Query(v1::QUERY_KIND_ANY_HIT, {}), 3, 3, kSummary);
  columns.WriteAny(0, std::vector<uint8_t>{1});
  columns.WriteAny(1, std::vector<uint8_t>{0, 1});
  EXPECT_EQ(ToHitBatch(columns.Take()).flags(), std::string({1, 0, 1}));
}

TEST(HitColumnsTest, CountsAndOffsetsHaveARowPerRay) {
  const BatchQuery query = Query(v1::QUERY_KIND_ALL_HITS, {v1::HIT_COLUMN_COUNT, v1::HIT_COLUMN_FLAGS});
  HitColumns columns(query, 2, 5, kSummary);
  columns.WriteHits(0, std::vector<Hit>(5, MakeHit(1, 0, 0, 0, true)), Squares(1));
  columns.WriteCounts(0, std::vector<uint32_t>{7, 9});
  columns.WriteOffsets(std::vector<uint32_t>{0, 2, 5});
  const v1::HitBatch batch = ToHitBatch(columns.Take());
  EXPECT_EQ(batch.count(), Bytes<uint32_t>({7, 9}));
  EXPECT_EQ(batch.offsets(), Bytes<uint32_t>({0, 2, 5}));
  EXPECT_EQ(batch.flags(), std::string(5, 3));
  EXPECT_EQ(BytesPerHit(query), 1u);
  EXPECT_EQ(BytesPerRay(query), 8u);  // count and offset
}

TEST(HitColumnsTest, LengthsOfAllSizesAreAsProtobufWritesThem) {
  const BatchQuery query = Query(v1::QUERY_KIND_CLOSEST_HIT, {v1::HIT_COLUMN_T, v1::HIT_COLUMN_FLAGS});
  for (const size_t rays : {0, 1, 31, 32, 127, 128, 4095, 4096, 16384, 600'000}) {
    HitColumns columns(query, rays, rays, kSummary);
    columns.WriteHits(0, std::vector<Hit>(rays), Squares(1));
    const v1::HitBatch batch = ToHitBatch(columns.Take());
    EXPECT_EQ(batch.t(), Bytes(std::vector<float>(rays, kInfinity)));
    EXPECT_EQ(batch.flags(), std::string(rays, '\0'));
    EXPECT_EQ(batch.ray_count(), rays);
  }
}

}  // namespace
}  // namespace deltaray
