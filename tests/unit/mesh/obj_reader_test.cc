#include "server/mesh/obj_reader.h"

#include "tests/unit/mesh/read.h"

namespace deltaray {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr char kTriangle[] = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";

ReadMeshResult ReadGoodObj(const std::string& text) {
  auto result = Read(text, MeshFormat::kObj);
  EXPECT_TRUE(result.ok()) << result.status() << "\nfor:\n" << text;
  return result.ok() ? *std::move(result) : ReadMeshResult();
}

void RefuseObj(const std::string& text, const std::vector<std::string>& parts) {
  ExpectRefused(text, MeshFormat::kObj, absl::StatusCode::kInvalidArgument, parts);
}

TEST(ObjReaderTest, ReadsAnOrdinaryFile) {
  const ReadMeshResult result = ReadGoodObj(
      "# a comment\r\nmtllib /etc/passwd\r\no thing\r\n"
      "v 0 0 0\r\nv 1 0 0 1.0\r\nv\t1 +1. 0 0.5 0.5 .5\r\n  v 0 1e0 -0.0 # last\r\n"
      "vt 0 0\r\nvn 0 0 1\r\ns off\r\nusemtl red paint\r\n"
      "f 1/1/1 2/1/1 3/1/1\r\nf 1//1 3//1 4//1 # second\r\n\r\nf 1/1 2/1 4/1");
  EXPECT_THAT(result.mesh.positions, ElementsAre(Vec3f{0, 0, 0}, Vec3f{1, 0, 0}, Vec3f{1, 1, 0}, Vec3f{0, 1, 0}));
  EXPECT_THAT(result.mesh.indices, ElementsAre(Corners{0, 1, 2}, Corners{0, 2, 3}, Corners{0, 1, 3}));
  EXPECT_THAT(result.mesh.face_ids, IsEmpty());
  EXPECT_THAT(result.mesh.groups, ElementsAre("thing"));
  EXPECT_THAT(result.mesh.group_ids, ElementsAre(0, 0, 0));
  EXPECT_EQ(result.mesh.face_count, 3u);
  EXPECT_EQ(result.mesh.origin, (Vec3d{0, 0, 0}));
  EXPECT_EQ(result.report.max_rounding, 0);
  EXPECT_THAT(result.report.warnings, IsEmpty());
}

TEST(ObjReaderTest, KeepsFaceIdsOfPolygons) {
  const ReadMeshResult result = ReadGoodObj("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 2 3 4\nf 1 3 4\n");
  EXPECT_THAT(result.mesh.indices, ElementsAre(Corners{0, 1, 2}, Corners{0, 1, 2}, Corners{0, 2, 3}, Corners{0, 2, 3}));
  EXPECT_THAT(result.mesh.face_ids, ElementsAre(0, 1, 1, 2));
  EXPECT_EQ(result.mesh.face_count, 3u);
}

TEST(ObjReaderTest, GroupsComeFromTheLastOfGAndO) {
  const std::string face = "f 1 2 3\n";
  const ReadMeshResult result =
      ReadGoodObj(kTriangle + face + "g  left   front \n" + face + "o unused\ng left front\n" + face + "o box #1\n" +
                  face + "g\n" + face + "g left front\n" + face);
  EXPECT_THAT(result.mesh.groups, ElementsAre("left front", "box #1"));
  EXPECT_THAT(result.mesh.group_ids, ElementsAre(kNoGroup, 0, 0, 1, kNoGroup, 0));
}

TEST(ObjReaderTest, GroupNamesThatAreNotUtf8AreMended) {
  const ReadMeshResult result = ReadGoodObj(std::string(kTriangle) + "g gr\xFCn\nf 1 2 3\n");
  EXPECT_THAT(result.mesh.groups, ElementsAre("gr\xEF\xBF\xBDn"));
  EXPECT_THAT(result.report.warnings, ElementsAre(HasSubstr("line 4")));
}

TEST(ObjReaderTest, NegativeIndicesCountBackFromTheFace) {
  const ReadMeshResult result = ReadGoodObj(std::string(kTriangle) + "f -3 -2 -1\nv 5 5 5\nf -1 -2 -3/-1/-1\n");
  EXPECT_THAT(result.mesh.indices, ElementsAre(Corners{0, 1, 2}, Corners{3, 2, 1}));
}

TEST(ObjReaderTest, FacesMayComeBeforeTheirVertices) {
  EXPECT_THAT(ReadGoodObj(std::string("f 1 2 3\n") + kTriangle).mesh.indices, ElementsAre(Corners{0, 1, 2}));
}

TEST(ObjReaderTest, LinesGoOnAfterABackslash) {
  const ReadMeshResult result = ReadGoodObj("v 0 0 \\\n0\nv 1 0 0\\\r\n\nv 0 1 0\n# C:\\\nf 1\\\n 2\\\n 3");
  EXPECT_THAT(result.mesh.indices, ElementsAre(Corners{0, 1, 2}));
  EXPECT_EQ(ReadGoodObj("v 0 0 0 \\").mesh.positions.size(), 1u);
}

TEST(ObjReaderTest, OtherGeometryIsPassedOverWithAWarning) {
  const ReadMeshResult result = ReadGoodObj(std::string(kTriangle) + "l 1 2\np 1\nl 2 3\nf 1 2 3\nv 1 1 1 2\n");
  EXPECT_EQ(result.mesh.indices.size(), 1u);
  EXPECT_THAT(result.report.warnings,
              ElementsAre(HasSubstr("2 statements \"l\" are passed over, the first in line 4"),
                          HasSubstr("1 statements \"p\" are passed over, the first in line 5"),
                          HasSubstr("1 vertices have a weight w other than 1, the first in line 8")));
}

TEST(ObjReaderTest, VerticesAloneAreAnEmptyMesh) {
  const ReadMeshResult result = ReadGoodObj("v 1 2 3\n");
  EXPECT_THAT(result.mesh.indices, IsEmpty());
  EXPECT_THAT(result.report.warnings, ElementsAre("The mesh has no triangle."));
}

// tinyobjloader gives (0, 0, 0) for the first two of these, and stops at the x of the third.
TEST(ObjReaderTest, RefusesWhatIsNotANumber) {
  RefuseObj("v nan 0 0\n", {"line 1", "\"nan\" is not a number", "number 1"});
  RefuseObj("v 0 0 0\nv 0 inf 0\n", {"line 2", "\"inf\"", "number 2"});
  RefuseObj("v 0 0 1x\n", {"line 1", "\"1x\"", "number 3"});
  RefuseObj("v 0 0 0x10\n", {"\"0x10\""});
  RefuseObj("v 1,5 0 0\n", {"\"1,5\""});
  RefuseObj("v 0 0 0 red\n", {"\"red\"", "number 4"});
  RefuseObj("v 1 2 -\n", {"\"-\""});
  RefuseObj("v 1 2 --3\n", {"\"--3\""});
  RefuseObj("v 1 2 +-3\n", {"\"+-3\""});
  RefuseObj("v 1 2 1e\n", {"\"1e\""});
  RefuseObj("v 1 2 .\n", {"\".\""});
  RefuseObj("v 1 2\n", {"line 1", "needs 3 coordinates and has 2"});
  RefuseObj("v\n", {"line 1", "has 0"});
  RefuseObj("v 1 2 3 4 5 6 7 8 9\n", {"line 1", "more than 8"});
}

TEST(ObjReaderTest, RefusesCoordinatesOutsideOfFloat32) {
  RefuseObj("v 0 1e39 0\n", {"line 1", "y = 1e+39", "float32"});
  RefuseObj("v 0 0 -1e999\n", {"line 1", "z = -inf", "float32"});
  EXPECT_EQ(ReadGoodObj("v 1e-400 1e-46 3.4028234e38\n").mesh.positions[0], (Vec3f{0, 0, 3.4028234e38f}));
}

// tinyobjloader reports success for all of these.
TEST(ObjReaderTest, RefusesBadIndices) {
  const std::string start = kTriangle;
  RefuseObj(start + "f 0 1 2\n", {"line 4", "vertex 0", "counts from 1"});
  RefuseObj(start + "f 1 2 4\n", {"line 4", "vertex 4", "has 3 vertices"});
  RefuseObj(start + "f 1 2 -4\n", {"line 4", "vertex -4", "3 vertices stand before it"});
  RefuseObj(start + "f 1 2 99999999999\n", {"line 4", "\"99999999999\" is not a corner"});
  RefuseObj(start + "f 1 2 2147483647\n", {"line 4", "vertex 2147483647"});
  RefuseObj(start + "f 1 2 -2147483648\n", {"line 4", "vertex -2147483648"});
  RefuseObj(start + "f 1 2 7\nf 1 2 9\nf 1 2 8\n", {"line 5", "vertex 9"});
}

TEST(ObjReaderTest, RefusesMalformedFaces) {
  const std::string start = kTriangle;
  RefuseObj(start + "f\n", {"line 4", "has 0"});
  RefuseObj(start + "f 1\n", {"line 4", "has 1"});
  RefuseObj(start + "f 1 2 # 3\n", {"line 4", "needs 3 corners or more and has 2"});
  RefuseObj(start + "f 1 2 x\n", {"line 4", "\"x\" is not a corner"});
  RefuseObj(start + "f 1 2 3x\n", {"line 4", "\"3x\""});
  RefuseObj(start + "f 1 2 3.0\n", {"line 4", "\"3.0\""});
  RefuseObj(start + "f 1 2 /3\n", {"line 4", "\"/3\""});
  RefuseObj(start + "f 1 2 3/1/1/1\n", {"line 4", "\"3/1/1/1\""});
  RefuseObj(start + "f 1 2 3/x\n", {"line 4", "\"3/x\""});
  RefuseObj(start + "f 1 2 3\x01\n", {"line 4", "\"3\\x01\""});
  RefuseObj(start + "f 1 2 +3\n", {"line 4", "\"+3\""});
}

TEST(ObjReaderTest, RefusesWhatIsNotObj) {
  RefuseObj("v 0 0 0\nhello world\n", {"line 2", "\"hello\" is not a statement of OBJ"});
  RefuseObj("# nothing\n", {"line 1", "without any vertex"});
  RefuseObj("", {"without any vertex"});
}

TEST(ObjReaderTest, HoldsToTheLimits) {
  const auto over = [](const std::string& text, const std::vector<std::string>& parts, const MeshLimits& limits) {
    ExpectRefused(text, MeshFormat::kObj, absl::StatusCode::kResourceExhausted, parts, limits);
  };
  const std::string start = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
  MeshLimits limits;
  limits.max_vertices = 3;
  over(start, {"line 4", "4 vertices", "3 (--max-vertices)"}, limits);
  limits = {};
  limits.max_triangles = 2;
  EXPECT_TRUE(Read(start + "f 1 2 3 4\n", MeshFormat::kObj, limits).ok());
  over(start + "f 1 2 3\nf 1 2 3 4\n", {"line 6", "3 triangles", "2 (--max-triangles)"}, limits);
  limits = {};
  limits.max_face_corners = 3;
  over(start + "f 1 2 3 4\n", {"line 5", "a face of 4 corners", "3 (--max-face-corners)"}, limits);
  limits = {};
  limits.max_line_bytes = 10;
  over(start + "# a comment\n", {"line 5", "11 bytes", "10 (--max-line-bytes)"}, limits);
  over(start + "f 1 \\\n2 \\\n3 \\\n4 \n", {"line 5", "10 (--max-line-bytes)"}, limits);
  limits = {};
  limits.max_groups = 1;
  EXPECT_TRUE(Read(start + "g a\nf 1 2 3\ng b\ng a\nf 1 2 3\n", MeshFormat::kObj, limits).ok());
  over(start + "g a\nf 1 2 3\ng b\nf 1 2 3\n", {"line 8", "2 groups", "1 (--max-groups)"}, limits);
  limits = {};
  limits.max_group_name_bytes = 4;
  over(start + "g abcd\ng abcde\n", {"line 6", "5 bytes", "4 (--max-group-name-bytes)"}, limits);
  limits = {};
  limits.max_group_bytes = 4;
  over(start + "g ab\nf 1 2 3\ng cd\nf 1 2 3\ng ab\nf 1 2 3\ng e\nf 1 2 3\n",
       {"line 12", "5 bytes", "4 (--max-group-bytes)"}, limits);
}

TEST(ObjReaderTest, KeepsAtMostAHundredWarnings) {
  std::string text = kTriangle;
  for (int i = 0; i < 150; ++i) text += "g \xFF\nf 1 2 3\n";
  const ReadMeshResult result = ReadGoodObj(text);
  ASSERT_EQ(result.report.warnings.size(), 100u);
  EXPECT_EQ(result.report.warnings[99], "51 more warnings are left out.");
}

}  // namespace
}  // namespace deltaray
