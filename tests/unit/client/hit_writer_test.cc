#include "client/hit_writer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <csignal>
#include <limits>
#include <sstream>

#include "client/exit_code.h"
#include "tests/unit/client/test_session.h"

namespace deltaray {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr float kInfinity = std::numeric_limits<float>::infinity();

template <typename T>
std::string Bytes(std::initializer_list<T> values) {
  return std::string(reinterpret_cast<const char*>(values.begin()), values.size() * sizeof(T));
}

// Two rays: a hit on the back of triangle 3, and a miss.
v1::HitBatch HitAndMiss() {
  v1::HitBatch hits;
  hits.set_ray_count(2);
  hits.set_t(Bytes<float>({0.1f, kInfinity}));
  hits.set_primitive_id(Bytes<uint32_t>({3, 0xFFFFFFFF}));
  hits.set_face_id(Bytes<uint32_t>({1, 0xFFFFFFFF}));
  hits.set_group_id(Bytes<uint32_t>({0xFFFFFFFF, 0xFFFFFFFF}));
  hits.set_uv(Bytes<float>({0.25f, 1e-10f, 0, 0}));
  hits.set_normal(Bytes<float>({0, -1, 0, 0, 0, 0}));
  hits.set_flags(Bytes<uint8_t>({3, 0}));
  return hits;
}

std::string Written(HitFormat format, v1::QueryKind kind, const std::vector<v1::HitColumn>& columns,
                    const std::vector<v1::HitBatch>& batches) {
  TestSession session;
  HitWriter writer(format, kind, *ResolveColumns(kind, columns), session.session().output);
  for (const v1::HitBatch& batch : batches) EXPECT_TRUE(writer.Write(batch).ok());
  EXPECT_TRUE(writer.End().ok());
  return session.TakeOutput();
}

const std::vector<v1::HitColumn> kAllColumns = {
    v1::HIT_COLUMN_FLAGS, v1::HIT_COLUMN_NORMAL,  v1::HIT_COLUMN_UV,          v1::HIT_COLUMN_GROUP_ID,
    v1::HIT_COLUMN_T,     v1::HIT_COLUMN_FACE_ID, v1::HIT_COLUMN_PRIMITIVE_ID};

TEST(HitWriterTest, WritesCsvAndCountsRaysOverBatches) {
  EXPECT_EQ(Written(HitFormat::kCsv, v1::QUERY_KIND_CLOSEST_HIT, {}, {HitAndMiss(), HitAndMiss()}),
            "ray,t,primitive_id,u,v,hit,back\n"
            "0,0.1,3,0.25,1e-10,1,1\n"
            "1,inf,4294967295,0,0,0,0\n"
            "2,0.1,3,0.25,1e-10,1,1\n"
            "3,inf,4294967295,0,0,0,0\n");
}

TEST(HitWriterTest, WritesAllColumnsInOrder) {
  EXPECT_EQ(Written(HitFormat::kCsv, v1::QUERY_KIND_CLOSEST_HIT, kAllColumns, {HitAndMiss()}),
            "ray,t,primitive_id,face_id,group_id,u,v,nx,ny,nz,hit,back\n"
            "0,0.1,3,1,4294967295,0.25,1e-10,0,-1,0,1,1\n"
            "1,inf,4294967295,4294967295,4294967295,0,0,0,0,0,0,0\n");
}

TEST(HitWriterTest, WritesJsonLinesWithNullForNone) {
  EXPECT_EQ(Written(HitFormat::kJson, v1::QUERY_KIND_CLOSEST_HIT, kAllColumns, {HitAndMiss()}),
            R"({"ray":0,"t":0.1,"primitive_id":3,"face_id":1,"group_id":null,"u":0.25,"v":1e-10,)"
            R"("nx":0,"ny":-1,"nz":0,"hit":true,"back":true})"
            "\n"
            R"({"ray":1,"t":null,"primitive_id":null,"face_id":null,"group_id":null,"u":0,"v":0,)"
            R"("nx":0,"ny":0,"nz":0,"hit":false,"back":false})"
            "\n");
}

TEST(HitWriterTest, WritesAlignedTable) {
  EXPECT_EQ(Written(HitFormat::kTable, v1::QUERY_KIND_CLOSEST_HIT, {v1::HIT_COLUMN_T}, {HitAndMiss()}),
            "       ray               t\n"
            "         0             0.1\n"
            "         1             inf\n");
}

TEST(HitWriterTest, WritesPackedRawRows) {
  EXPECT_EQ(Written(HitFormat::kRaw, v1::QUERY_KIND_CLOSEST_HIT,
                    {v1::HIT_COLUMN_T, v1::HIT_COLUMN_UV, v1::HIT_COLUMN_FLAGS}, {HitAndMiss()}),
            Bytes<float>({0.1f, 0.25f, 1e-10f}) + '\3' + Bytes<float>({kInfinity, 0, 0}) + '\0');
}

TEST(HitWriterTest, WritesAnyHitAndCounts) {
  v1::HitBatch any;
  any.set_ray_count(2);
  any.set_flags(Bytes<uint8_t>({1, 0}));
  EXPECT_EQ(Written(HitFormat::kCsv, v1::QUERY_KIND_ANY_HIT, {}, {any}), "ray,hit\n0,1\n1,0\n");
  v1::HitBatch counts;
  counts.set_ray_count(2);
  counts.set_count(Bytes<uint32_t>({0, 4000000000}));
  EXPECT_EQ(Written(HitFormat::kCsv, v1::QUERY_KIND_COUNT_HITS, {}, {counts}), "ray,count\n0,0\n1,4000000000\n");
}

v1::HitBatch ThreeRaysWithAllHits() {
  v1::HitBatch hits;
  hits.set_ray_count(3);
  hits.set_offsets(Bytes<uint32_t>({0, 2, 2, 3}));
  hits.set_t(Bytes<float>({1, 2, 3}));
  return hits;
}

TEST(HitWriterTest, WritesARowForEachOfAllHits) {
  const std::vector<v1::HitColumn> columns = {v1::HIT_COLUMN_T};
  const v1::HitBatch hits = ThreeRaysWithAllHits();
  EXPECT_EQ(Written(HitFormat::kCsv, v1::QUERY_KIND_ALL_HITS, columns, {hits, hits}),
            "ray,t\n0,1\n0,2\n2,3\n3,1\n3,2\n5,3\n");
  EXPECT_EQ(Written(HitFormat::kRaw, v1::QUERY_KIND_ALL_HITS, columns, {hits}),
            Bytes<uint64_t>({0}) + Bytes<float>({1}) + Bytes<uint64_t>({0}) + Bytes<float>({2}) + Bytes<uint64_t>({2}) +
                Bytes<float>({3}));
}

TEST(HitWriterTest, WritesTheCountOfTheRayOnEachOfItsRows) {
  const std::vector<v1::HitColumn> columns = {v1::HIT_COLUMN_T, v1::HIT_COLUMN_COUNT};
  v1::HitBatch hits = ThreeRaysWithAllHits();
  hits.set_count(Bytes<uint32_t>({7, 0, 1}));
  EXPECT_EQ(Written(HitFormat::kCsv, v1::QUERY_KIND_ALL_HITS, columns, {hits}), "ray,t,count\n0,1,7\n0,2,7\n2,3,1\n");
  EXPECT_EQ(Written(HitFormat::kRaw, v1::QUERY_KIND_ALL_HITS, {v1::HIT_COLUMN_COUNT}, {hits}),
            Bytes<uint64_t>({0}) + Bytes<uint32_t>({7}) + Bytes<uint64_t>({0}) + Bytes<uint32_t>({7}) +
                Bytes<uint64_t>({2}) + Bytes<uint32_t>({1}));
}

TEST(HitWriterTest, WritesTheHeaderOnceThereIsAnAnswer) {
  EXPECT_EQ(Written(HitFormat::kCsv, v1::QUERY_KIND_COUNT_HITS, {}, {}), "ray,count\n");
  TestSession session;
  HitWriter writer(HitFormat::kCsv, v1::QUERY_KIND_COUNT_HITS, {v1::HIT_COLUMN_COUNT}, session.session().output);
  v1::HitBatch bad;
  bad.set_ray_count(1);
  EXPECT_FALSE(writer.Write(bad).ok());
  EXPECT_EQ(session.TakeOutput(), "");
}

TEST(HitWriterTest, FloatsReadBackAsTheSameBits) {
  v1::HitBatch hits;
  const std::initializer_list<float> values = {16777216.0f, 0.1f + 0.2f, 1e-45f, 3.4028235e38f, -1.17549435e-38f};
  hits.set_ray_count(values.size());
  hits.set_t(Bytes<float>(values));
  const std::string text = Written(HitFormat::kCsv, v1::QUERY_KIND_CLOSEST_HIT, {v1::HIT_COLUMN_T}, {hits});
  std::istringstream lines(text);
  std::string line;
  std::getline(lines, line);
  for (const float value : values) {
    ASSERT_TRUE(std::getline(lines, line));
    EXPECT_EQ(std::strtof(line.c_str() + line.find(',') + 1, nullptr), value) << line;
  }
}

TEST(HitWriterTest, RefusesColumnsOfWrongLength) {
  TestSession session;
  HitWriter writer(HitFormat::kCsv, v1::QUERY_KIND_CLOSEST_HIT, {v1::HIT_COLUMN_T, v1::HIT_COLUMN_UV},
                   session.session().output);
  v1::HitBatch hits = HitAndMiss();
  hits.mutable_uv()->pop_back();
  EXPECT_THAT(std::string(writer.Write(hits).message()), HasSubstr("has 15 bytes of uv for 2 rows"));
  EXPECT_EQ(session.TakeOutput(), "");
}

TEST(HitWriterTest, RefusesBadOffsets) {
  TestSession session;
  HitWriter writer(HitFormat::kCsv, v1::QUERY_KIND_ALL_HITS, {v1::HIT_COLUMN_T}, session.session().output);
  v1::HitBatch hits = ThreeRaysWithAllHits();
  hits.set_offsets(Bytes<uint32_t>({0, 2, 1, 3}));
  EXPECT_THAT(std::string(writer.Write(hits).message()), HasSubstr("offset 1 at 2, after 2"));
  hits.set_offsets(Bytes<uint32_t>({1, 2, 2, 3}));
  EXPECT_THAT(std::string(writer.Write(hits).message()), HasSubstr("offset 1 at 0"));
  hits.set_offsets(Bytes<uint32_t>({0, 2, 3}));
  EXPECT_THAT(std::string(writer.Write(hits).message()), HasSubstr("12 bytes of offsets for 3 rays"));
  hits.set_offsets(Bytes<uint32_t>({0, 2, 2, 4}));
  EXPECT_THAT(std::string(writer.Write(hits).message()), HasSubstr("12 bytes of t for 4 rows"));
}

TEST(HitWriterTest, ReaderThatHasGoneIsNoFailure) {
  signal(SIGPIPE, SIG_IGN);
  int pipe_ends[2];
  ASSERT_EQ(pipe(pipe_ends), 0);
  close(pipe_ends[0]);
  std::FILE* output = fdopen(pipe_ends[1], "w");
  HitWriter writer(HitFormat::kCsv, v1::QUERY_KIND_CLOSEST_HIT, {v1::HIT_COLUMN_T}, output);
  EXPECT_TRUE(IsOutputClosed(writer.End()));
  std::fclose(output);
}

TEST(ResolveColumnsTest, FillsInTheDefaultOfEachKind) {
  EXPECT_THAT(*ResolveColumns(v1::QUERY_KIND_CLOSEST_HIT, {}),
              ElementsAre(v1::HIT_COLUMN_T, v1::HIT_COLUMN_PRIMITIVE_ID, v1::HIT_COLUMN_UV, v1::HIT_COLUMN_FLAGS));
  EXPECT_THAT(*ResolveColumns(v1::QUERY_KIND_ALL_HITS, {}),
              ElementsAre(v1::HIT_COLUMN_T, v1::HIT_COLUMN_PRIMITIVE_ID, v1::HIT_COLUMN_UV, v1::HIT_COLUMN_FLAGS,
                          v1::HIT_COLUMN_COUNT));
  EXPECT_THAT(*ResolveColumns(v1::QUERY_KIND_ANY_HIT, {}), ElementsAre(v1::HIT_COLUMN_FLAGS));
  EXPECT_THAT(*ResolveColumns(v1::QUERY_KIND_COUNT_HITS, {}), ElementsAre(v1::HIT_COLUMN_COUNT));
}

TEST(ResolveColumnsTest, RefusesWhatTheKindLacksAndRepetition) {
  const auto any_t = ResolveColumns(v1::QUERY_KIND_ANY_HIT, {v1::HIT_COLUMN_T});
  EXPECT_EQ(any_t.status().message(), "--columns: t is not a column of any_hit");
  EXPECT_EQ(ExitCode(any_t.status()), kExitUsage);
  EXPECT_FALSE(ResolveColumns(v1::QUERY_KIND_CLOSEST_HIT, {v1::HIT_COLUMN_COUNT}).ok());
  EXPECT_EQ(ResolveColumns(v1::QUERY_KIND_CLOSEST_HIT, {v1::HIT_COLUMN_T, v1::HIT_COLUMN_T}).status().message(),
            "--columns: t stands twice");
}

}  // namespace
}  // namespace deltaray
