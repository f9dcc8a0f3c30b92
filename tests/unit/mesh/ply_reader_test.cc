#include "server/mesh/ply_reader.h"

#include <algorithm>
#include <cstring>

#include "tests/unit/mesh/read.h"

namespace deltaray {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr char kAsciiHeader[] =
    "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 4\nproperty float x\nproperty float y\n"
    "property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n";
constexpr char kVertices[] = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n";

ReadMeshResult ReadGoodPly(const std::string& bytes) {
  auto result = Read(bytes);
  EXPECT_TRUE(result.ok()) << result.status();
  if (!result.ok()) return {};
  EXPECT_EQ(result->format, MeshFormat::kPly);
  return *std::move(result);
}

void RefusePly(const std::string& bytes, const std::vector<std::string>& parts) {
  ExpectRefused(bytes, MeshFormat::kPly, absl::StatusCode::kInvalidArgument, parts);
}

// The bytes of `value` in the order of the file.
template <typename T>
std::string Bytes(T value, bool big_endian) {
  std::string bytes(sizeof(T), '\0');
  std::memcpy(bytes.data(), &value, sizeof(T));
  if (big_endian) std::reverse(bytes.begin(), bytes.end());
  return bytes;
}

// A square of two triangles, with properties of all types and elements that are not read.
std::string BinarySquare(bool big) {
  std::string bytes = std::string("ply\nformat binary_") + (big ? "big" : "little") +
                      "_endian 1.0\nelement junk 2\nproperty list ushort double many\nproperty int8 one\n"
                      "element vertex 4\nproperty uchar red\nproperty double z\nproperty short x\nproperty float32 y\n"
                      "property list uchar int empty\nelement face 2\nproperty float quality\n"
                      "property list uint8 uint16 vertex_index\nend_header\n";
  for (int i = 0; i < 2; ++i) {
    bytes += Bytes<uint16_t>(i, big);
    if (i == 1) bytes += Bytes<double>(7, big);
    bytes += Bytes<int8_t>(1, big);
  }
  for (int i = 0; i < 4; ++i) {
    bytes += Bytes<uint8_t>(255, big) + Bytes<double>(-0.5, big) + Bytes<int16_t>(i == 1 || i == 2 ? -300 : 0, big) +
             Bytes<float>(i >= 2, big) + Bytes<uint8_t>(0, big);
  }
  for (int i = 0; i < 2; ++i) {
    bytes += Bytes<float>(1, big) + Bytes<uint8_t>(3, big) + Bytes<uint16_t>(0, big) + Bytes<uint16_t>(1 + i, big) +
             Bytes<uint16_t>(2 + i, big);
  }
  return bytes;
}

TEST(PlyReaderTest, ReadsAscii) {
  const ReadMeshResult result = ReadGoodPly(std::string(kAsciiHeader) + kVertices + "3 0 1 2\n4 0 1 2 3\n");
  EXPECT_THAT(result.mesh.positions, ElementsAre(Vec3f{0, 0, 0}, Vec3f{1, 0, 0}, Vec3f{1, 1, 0}, Vec3f{0, 1, 0}));
  EXPECT_THAT(result.mesh.indices, ElementsAre(Corners{0, 1, 2}, Corners{0, 1, 2}, Corners{0, 2, 3}));
  EXPECT_THAT(result.mesh.face_ids, ElementsAre(0, 1, 1));
  EXPECT_EQ(result.mesh.face_count, 2u);
  EXPECT_THAT(result.report.warnings, IsEmpty());
}

TEST(PlyReaderTest, ReadsAsciiWithOtherLineEndsAndAByteOrderMark) {
  const std::string text = std::string(kAsciiHeader) + kVertices + "3 0 1 2\n4 0 1 2 3";
  for (const std::string end : {"\r\n", "\r", "\n\n"}) {
    std::string other = "\xEF\xBB\xBF";
    for (const char c : text) other += c == '\n' ? end : std::string(1, c);
    EXPECT_EQ(ReadGoodPly(other).mesh.indices.size(), 3u);
  }
}

TEST(PlyReaderTest, ReadsBothBinaryOrders) {
  for (const bool big : {false, true}) {
    const ReadMeshResult result = ReadGoodPly(BinarySquare(big));
    EXPECT_THAT(result.mesh.positions,
                ElementsAre(Vec3f{0, 0, -0.5f}, Vec3f{-300, 0, -0.5f}, Vec3f{-300, 1, -0.5f}, Vec3f{0, 1, -0.5f}));
    EXPECT_THAT(result.mesh.indices, ElementsAre(Corners{0, 1, 2}, Corners{0, 2, 3}));
    EXPECT_THAT(result.report.warnings, IsEmpty());
  }
}

TEST(PlyReaderTest, PassesOverValuesThatAreNotNumbersWhereTheyDoNotCount) {
  const std::string header = With(kAsciiHeader, "property float z\n", "property float z\nproperty float nx\n");
  EXPECT_EQ(ReadGoodPly(header + "0 0 0 nan\n1 0 0 -\n1 1 0 inf\n0 1 0 1\n3 0 1 2\n3 0 2 3\n").mesh.indices.size(), 2u);
}

TEST(PlyReaderTest, FacesMayStandBeforeVertices) {
  const std::string text =
      "ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int vertex_index\nelement vertex 3\n"
      "property double x\nproperty double y\nproperty double z\nend_header\n3 0 1 2\n0 0 0\n1 0 0\n0 1 0\n";
  EXPECT_THAT(ReadGoodPly(text).mesh.indices, ElementsAre(Corners{0, 1, 2}));
  RefusePly(With(text, "3 0 1 2", "3 0 1 3"), {"line 10", "vertex 3", "has 3 vertices, counted from 0"});
}

TEST(PlyReaderTest, PointsAloneAreAnEmptyMesh) {
  const std::string text =
      "ply\nformat ascii 1.0\nelement vertex 1\nproperty int x\nproperty int y\nproperty int z\nend_header\n1 2 3\n";
  EXPECT_THAT(ReadGoodPly(text).mesh.indices, IsEmpty());
  EXPECT_THAT(ReadGoodPly(With(With(text, "vertex 1", "vertex 0"), "1 2 3\n", "")).mesh.positions, IsEmpty());
}

TEST(PlyReaderTest, WarnsOfWhatFollowsTheLastElement) {
  EXPECT_THAT(ReadGoodPly(std::string(kAsciiHeader) + kVertices + "3 0 1 2\n4 0 1 2 3\n9 9\n").report.warnings,
              ElementsAre(HasSubstr("4 bytes after the last element")));
}

TEST(PlyReaderTest, RefusesMalformedHeaders) {
  const std::string body = std::string(kVertices) + "3 0 1 2\n4 0 1 2 3\n", good = kAsciiHeader + body;
  RefusePly("plyx\n", {"line 1", "begins with the line \"ply\""});
  RefusePly(With(good, "format ascii 1.0\n", ""), {"line 9", "no line \"format\""});
  RefusePly(With(good, "ascii", "utf8"), {"line 2", "\"utf8\" is not a format"});
  RefusePly(With(good, "1.0", "2.0"), {"line 2", "version \"2.0\""});
  RefusePly(With(good, "comment", "remark"), {"line 3", "\"remark\" is not a statement"});
  RefusePly(With(good, "vertex 4", "vertex"), {"line 4", "\"vertex\" has the count \"\""});
  RefusePly(With(good, "vertex 4", "vertex -4"), {"line 4", "\"-4\""});
  RefusePly(With(good, "vertex 4", "vertex 99999999999999999999"), {"line 4", "\"99999999999999999999\""});
  RefusePly(With(good, "element vertex 4", "element"), {"line 4", "needs a name"});
  RefusePly(With(good, "element vertex 4\n", ""), {"line 4", "before any element"});
  RefusePly(With(good, "element face 2", "element vertex 2"), {"line 8", "\"vertex\" is there twice"});
  RefusePly(With(good, "float x", "flat x"), {"line 5", "\"flat\" is not a type"});
  RefusePly(With(good, "float x", "float"), {"line 5", "needs a name"});
  RefusePly(With(good, "float y", "float x"), {"line 6", "property \"x\" twice"});
  RefusePly(With(good, "float y", "float w"), {"line 4", "no property \"y\""});
  RefusePly(With(good, "float y", "list uchar float y"), {"line 4", "\"y\" is a list"});
  RefusePly(With(good, "uchar int", "float int"), {"line 9", "\"float\" is not a type for the length"});
  RefusePly(With(good, "uchar int", "uchar float"), {"line 8", "not a list of integers"});
  RefusePly(With(good, "list uchar int vertex_indices", "int vertex_indices"), {"line 8", "not a list of integers"});
  RefusePly(With(good, "vertex_indices", "corners"), {"line 8", "no property \"vertex_indices\""});
  RefusePly(With(good, "element face", "element tristrips"), {"line 8", "triangle strips"});
  RefusePly("ply\nformat ascii 1.0\nend_header\n", {"line 3", "no element \"vertex\""});
  RefusePly("ply\nformat ascii 1.0\nelement vertex 4\n", {"line 3", "ends in the header"});
}

TEST(PlyReaderTest, RefusesMalformedAsciiBodies) {
  const std::string good = std::string(kAsciiHeader) + kVertices + "3 0 1 2\n3 0 2 3\n";
  RefusePly(With(good, "1 1 0", "1 1"), {"line 13", "ends before property \"z\""});
  RefusePly(With(good, "1 1 0", "1 1 0 5"), {"line 13", "\"5\" follows the last property"});
  RefusePly(With(good, "1 1 0", "1 one 0"), {"line 13", "\"one\" is not a number, in property \"y\""});
  RefusePly(With(good, "1 1 0", "1 nan 0"), {"line 13", "\"nan\""});
  RefusePly(With(good, "1 1 0", "1 1e39 0"), {"line 13", "y = 1e+39", "float32"});
  RefusePly(With(good, "3 0 1 2", "3 0 1"), {"line 15", "ends before property \"vertex_indices\""});
  RefusePly(With(good, "3 0 1 2", "2 0 1"), {"line 15", "needs 3 corners or more and has 2"});
  RefusePly(With(good, "3 0 1 2", "-3 0 1 2"), {"line 15", "length of list \"vertex_indices\" is -3"});
  RefusePly(With(good, "3 0 1 2", "3.5 0 1 2"), {"line 15", "is 3.5"});
  RefusePly(With(good, "3 0 1 2", "3 0 1 4"), {"line 15", "vertex 4", "has 4 vertices, counted from 0"});
  RefusePly(With(good, "3 0 1 2", "3 0 1 -1"), {"line 15", "vertex -1", "not an index"});
  RefusePly(With(good, "3 0 1 2", "3 0 1 0.5"), {"line 15", "vertex 0.5", "not an index"});
  RefusePly(With(good, "3 0 2 3\n", ""), {"line 15", "ends after 1 of 2 rows of element \"face\""});
}

TEST(PlyReaderTest, CountsThatLieSetNoMemoryAside) {
  for (const char* count : {"1000000000000", "99999999", "18446744073709551615"}) {
    const std::string text = With(kAsciiHeader, "vertex 4", std::string("vertex ") + count) + kVertices;
    const absl::Status status = Read(text).status();
    EXPECT_FALSE(status.ok());
    EXPECT_THAT(std::string(status.message()), HasSubstr(count));
  }
  const std::string binary = BinarySquare(false);
  RefusePly(With(binary, "junk 2", "junk 4000000000"), {"byte ", "ends in element \"junk\", whose 4000000000 rows"});
  // An element without properties has no bytes, however many rows it has.
  EXPECT_EQ(
      ReadGoodPly(With(binary, "element junk", "element none 18446744073709551615\nelement junk")).mesh.indices.size(),
      2u);
}

TEST(PlyReaderTest, BinaryErrorsNameTheByte) {
  const std::string good = BinarySquare(false);
  const size_t faces = good.size() - 2 * 11;
  std::string bad = good;
  bad[faces + 4 + 1 + 2] = 9;
  RefusePly(bad, {"byte " + std::to_string(faces), "vertex 9", "has 4 vertices"});
  bad = good;
  bad[faces + 4] = 2;
  RefusePly(bad, {"byte " + std::to_string(faces), "has 2"});
  bad = good;
  bad[faces + 11 + 4] = 4;
  RefusePly(bad,
            {"byte ", "the file ends in property \"vertex_index\" of the row at byte " + std::to_string(faces + 11)});
  bad = good;
  const size_t third_vertex = faces - 2 * 16;
  for (int i = 0; i < 8; ++i) bad[third_vertex + 1 + i] = '\xFF';
  RefusePly(bad, {"byte " + std::to_string(third_vertex), "z = nan"});
}

TEST(PlyReaderTest, EveryTruncationIsRefused) {
  for (const std::string& good :
       {BinarySquare(false), BinarySquare(true), std::string(kAsciiHeader) + kVertices + "3 0 1 2\n4 0 1 2 3"}) {
    for (size_t size = 0; size < good.size(); ++size) {
      const absl::Status status = Read(good.substr(0, size), MeshFormat::kPly).status();
      EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << size;
      EXPECT_THAT(std::string(status.message()), testing::ContainsRegex("^(line|byte) [0-9]+: ")) << size;
    }
  }
}

TEST(PlyReaderTest, HoldsToTheLimits) {
  const auto over = [](const std::string& text, const std::vector<std::string>& parts, const MeshLimits& limits) {
    ExpectRefused(text, MeshFormat::kPly, absl::StatusCode::kResourceExhausted, parts, limits);
  };
  const std::string good = std::string(kAsciiHeader) + kVertices + "4 0 1 2 3\n3 0 2 3\n";
  MeshLimits limits;
  limits.max_vertices = 3;
  over(good, {"line 4", "4 vertices", "3 (--max-vertices)"}, limits);
  limits = {};
  limits.max_triangles = 1;
  over(good, {"line 8", "2 faces", "1 (--max-triangles)"}, limits);
  limits.max_triangles = 2;
  over(good, {"line 16", "3 triangles", "2 (--max-triangles)"}, limits);
  limits = {};
  limits.max_face_corners = 3;
  over(good, {"line 15", "4 corners", "3 (--max-face-corners)"}, limits);
  limits = {};
  limits.max_line_bytes = 37;
  over(good, {"line 9", "38 bytes", "37 (--max-line-bytes)"}, limits);
  std::string many = "ply\nformat ascii 1.0\nelement vertex 0\n";
  for (int i = 0; i <= 1024; ++i) many += "property int p" + std::to_string(i) + "\n";
  over(many, {"line 1028", "1024 (properties of an element)"}, {});
  many = "ply\nformat ascii 1.0\n";
  for (int i = 0; i <= 1024; ++i) many += "element e" + std::to_string(i) + " 0\n";
  over(many, {"line 1027", "1024 (elements of a header)"}, {});
}

}  // namespace
}  // namespace deltaray
