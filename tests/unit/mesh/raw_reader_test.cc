#include "server/mesh/raw_reader.h"

#include <cmath>
#include <cstring>

#include "tests/unit/mesh/read.h"

namespace deltaray {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

template <typename T>
std::string Bytes(const std::vector<T>& values) {
  return std::string(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T));
}

absl::StatusOr<ReadMeshResult> ReadArrays(const std::string& bytes, RawLayout layout, const MeshLimits& limits = {}) {
  ReadMeshOptions options;
  options.format = MeshFormat::kRaw;
  options.raw = layout;
  options.limits = limits;
  return ReadMesh(bytes, options);
}

void RefuseRaw(const std::string& bytes, RawLayout layout, absl::StatusCode code, const std::vector<std::string>& parts,
               const MeshLimits& limits = {}) {
  const absl::Status status = ReadArrays(bytes, layout, limits).status();
  EXPECT_EQ(status.code(), code) << status;
  for (const std::string& part : parts) EXPECT_THAT(std::string(status.message()), HasSubstr(part));
}

const std::string kIndices = Bytes<uint32_t>({0, 1, 2});

TEST(RawReaderTest, FloatsKeepTheirValuesWhereverTheyAre) {
  // Far from zero, with a denormal, and exact: the origin stays zero.
  const std::vector<float> floats = {5e6f, 5e6f + 0.5f, 1e-44f, 5e6f + 1, 5e6f, -0.0f, 5e6f, 5e6f + 3, 3.4e38f};
  const auto result = ReadArrays(Bytes(floats) + kIndices, {3, 1, false});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->format, MeshFormat::kRaw);
  EXPECT_EQ(std::memcmp(result->mesh.positions.data(), floats.data(), 20), 0);
  EXPECT_FALSE(std::signbit(result->mesh.positions[1].z));
  EXPECT_EQ(result->mesh.origin, (Vec3d{0, 0, 0}));
  EXPECT_EQ(result->report.max_rounding, 0);
  EXPECT_THAT(result->mesh.indices, ElementsAre(Corners{0, 1, 2}));
  EXPECT_EQ(result->mesh.face_count, 1u);
}

TEST(RawReaderTest, FarFloatsGetAnOriginAsFarDoublesDo) {
  const std::vector<float> floats = {500000, 5400000, 0, 500100, 5400000, 12.25f, 500100, 5400100, 100};
  const auto result = ReadArrays(Bytes(floats) + kIndices, {3, 1, false});
  const auto doubles = ReadArrays(Bytes(std::vector<double>(floats.begin(), floats.end())) + kIndices, {3, 1, true});
  ASSERT_TRUE(result.ok() && doubles.ok()) << result.status() << doubles.status();
  EXPECT_EQ(result->mesh.origin, (Vec3d{500096, 5400064, 0}));
  EXPECT_EQ(doubles->mesh.origin, result->mesh.origin);
  EXPECT_EQ(result->mesh.positions, doubles->mesh.positions);
  EXPECT_EQ(result->mesh.positions[1], (Vec3f{4, -64, 12.25f}));
  EXPECT_EQ(result->report.max_rounding, 0);
}

TEST(RawReaderTest, DoublesGetAnOriginWhereTheyNeedOne) {
  const auto result =
      ReadArrays(Bytes<double>({500000.1, 0, 0, 500001.1, 0, 0, 500000.1, 1, 0}) + kIndices, {3, 1, true});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->mesh.origin, (Vec3d{500001, 0, 0}));
  EXPECT_GT(result->report.max_rounding, 0);
  EXPECT_LT(result->report.max_rounding, 1e-7);
}

TEST(RawReaderTest, NothingIsAnEmptyMesh) {
  const auto result = ReadArrays("", {0, 0, false});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_THAT(result->mesh.indices, IsEmpty());
  EXPECT_TRUE(result->report.bounds.IsEmpty());
}

TEST(RawReaderTest, RefusesSizesThatDoNotFitTheCounts) {
  const auto code = absl::StatusCode::kInvalidArgument;
  const std::string bytes = Bytes<float>({0, 0, 0, 1, 0, 0, 0, 1, 0}) + kIndices;
  for (size_t size = 0; size < bytes.size(); ++size) {
    RefuseRaw(bytes.substr(0, size), {3, 1, false}, code,
              {"byte " + std::to_string(size), "take 48 bytes, but there are"});
  }
  RefuseRaw(bytes + "x", {3, 1, false}, code, {"byte 48", "but there are 49"});
  RefuseRaw(bytes, {3, 1, true}, code, {"3 vertices in float64 and 1 triangles take 84 bytes"});
}

TEST(RawReaderTest, RefusesBadValues) {
  const auto code = absl::StatusCode::kInvalidArgument;
  RefuseRaw(Bytes<float>({0, 0, 0, 1, NAN, 0, 0, 1, 0}) + kIndices, {3, 1, false}, code,
            {"byte 16", "vertex 1", "y = nan"});
  RefuseRaw(Bytes<double>({0, 0, 0, 1, 0, 1e39, 0, 1, 0}) + kIndices, {3, 1, true}, code,
            {"byte 40", "vertex 1", "z = 1e+39"});
  RefuseRaw(Bytes<float>({0, 0, 0}) + Bytes<uint32_t>({0, 0, 0, 0, 1, 0}), {1, 2, false}, code,
            {"byte 28", "triangle 1 names vertex 1, but there are 1 vertices"});
}

TEST(RawReaderTest, HoldsToTheLimits) {
  const auto code = absl::StatusCode::kResourceExhausted;
  MeshLimits limits;
  limits.max_vertices = 2;
  RefuseRaw("", {3, 1, false}, code, {"header.raw_layout.vertex_count: 3 vertices", "2 (--max-vertices)"}, limits);
  limits = {};
  limits.max_triangles = 0;
  RefuseRaw("", {3, 1, false}, code, {"header.raw_layout.triangle_count: 1 triangles", "0 (--max-triangles)"}, limits);
  // Counts whose sizes would wrap round.
  RefuseRaw("", {uint64_t{1} << 62, 0, false}, code, {"--max-vertices"});
  RefuseRaw("", {0, ~uint64_t{0}, true}, code, {"--max-triangles"});
}

}  // namespace
}  // namespace deltaray
