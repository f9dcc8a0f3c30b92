#include "server/mesh/stl_reader.h"

#include <cmath>
#include <cstring>
#include <limits>

#include "tests/unit/mesh/read.h"

namespace deltaray {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

ReadMeshResult ReadGoodStl(const std::string& bytes) {
  auto result = Read(bytes);
  EXPECT_TRUE(result.ok()) << result.status();
  if (!result.ok()) return {};
  EXPECT_EQ(result->format, MeshFormat::kStl);
  return *std::move(result);
}

void RefuseStl(const std::string& bytes, const std::vector<std::string>& parts) {
  ExpectRefused(bytes, MeshFormat::kStl, absl::StatusCode::kInvalidArgument, parts);
}

using Facet = std::array<Vec3f, 3>;

std::string Binary(const std::string& header, const std::vector<Facet>& facets) {
  std::string bytes = header;
  bytes.resize(80, ' ');
  const uint32_t count = facets.size();
  bytes.append(reinterpret_cast<const char*>(&count), 4);
  for (const Facet& facet : facets) {
    // The normal is nonsense, as in many files.
    const Vec3f normal{NAN, 0, 0};
    bytes.append(reinterpret_cast<const char*>(&normal), 12);
    bytes.append(reinterpret_cast<const char*>(&facet), 36);
    bytes.append("\x12\x34", 2);
  }
  return bytes;
}

const std::vector<Facet> kSquare = {{Vec3f{0, 0, 0}, {1, 0, 0}, {1, 1, 0}},
                                    {Vec3f{-0.0f, 0, 0}, {1, 1, 0}, {0, 1, 1e-40f}}};

constexpr char kAscii[] =
    "solid left part\n"
    " facet normal 0 0 nan\n  outer loop\n   vertex 0 0 0\n   vertex 1 0 0\n   vertex 1 1 0\n  endloop\n endfacet\n"
    "endsolid left part\n"
    "SOLID\n"
    " FACET NORMAL 0 0 1\n  OUTER LOOP\n   VERTEX -0.0 0 0\n   VERTEX 1 1.0 0\n   VERTEX 0 1E0 0\n  ENDLOOP\n "
    "ENDFACET\n"
    "ENDSOLID\n";

TEST(StlReaderTest, ReadsBinaryWhateverItsHeaderSays) {
  for (const char* header : {"made by hand", "solid as a rock", "solid x\nfacet normal 0 0 0\n", "v 1 2 3"}) {
    const ReadMeshResult result = ReadGoodStl(Binary(header, kSquare));
    EXPECT_THAT(result.mesh.positions,
                ElementsAre(Vec3f{0, 0, 0}, Vec3f{1, 0, 0}, Vec3f{1, 1, 0}, Vec3f{0, 1, 1e-40f}));
    EXPECT_THAT(result.mesh.indices, ElementsAre(Corners{0, 1, 2}, Corners{0, 2, 3}));
    EXPECT_THAT(result.mesh.groups, IsEmpty());
    EXPECT_EQ(result.mesh.face_count, 2u);
    EXPECT_EQ(result.report.max_rounding, 0);
  }
  EXPECT_THAT(ReadGoodStl(Binary("", {})).mesh.indices, IsEmpty());
}

TEST(StlReaderTest, ReadsAsciiWithASolidPerGroup) {
  const ReadMeshResult result = ReadGoodStl(kAscii);
  EXPECT_THAT(result.mesh.positions, ElementsAre(Vec3f{0, 0, 0}, Vec3f{1, 0, 0}, Vec3f{1, 1, 0}, Vec3f{0, 1, 0}));
  EXPECT_THAT(result.mesh.indices, ElementsAre(Corners{0, 1, 2}, Corners{0, 2, 3}));
  EXPECT_THAT(result.mesh.groups, ElementsAre("left part"));
  EXPECT_THAT(result.mesh.group_ids, ElementsAre(0, kNoGroup));
  EXPECT_FALSE(std::signbit(result.mesh.positions[0].x));
}

TEST(StlReaderTest, ReadsAsciiWithOtherLineEndsAndAByteOrderMark) {
  for (const std::string end : {"\r\n", "\r", "\n \n"}) {
    std::string text = "\xEF\xBB\xBF\n";
    for (const char c : std::string(kAscii)) text += c == '\n' ? end : std::string(1, c);
    EXPECT_EQ(ReadGoodStl(text).mesh.indices.size(), 2u);
  }
  EXPECT_THAT(ReadGoodStl("solid nothing\nendsolid nothing").mesh.indices, IsEmpty());
}

TEST(StlReaderTest, RefusesMalformedAscii) {
  RefuseStl("", {"line 1", "ends where \"solid\" is expected"});
  RefuseStl("facet\n", {"line 1", "\"solid\" is expected, not \"facet\""});
  RefuseStl(With(kAscii, " facet", " face"), {"line 2", "\"facet\" or \"endsolid\" is expected"});
  RefuseStl(With(kAscii, "outer loop", "outer"), {"line 3", "\"outer loop\" is expected"});
  RefuseStl(With(kAscii, "   vertex 1 1 0\n", ""), {"line 6", "\"vertex\" is expected, not \"  endloop\""});
  RefuseStl(With(kAscii, "  endloop\n", "vertex 1 2 3\n"), {"line 7", "\"endloop\" is expected"});
  RefuseStl(With(kAscii, " endfacet\n", ""), {"line 8", "\"endfacet\" is expected"});
  RefuseStl(With(kAscii, "1 1 0", "1 1"), {"line 6", "\"\" is not a number, as coordinate 3"});
  RefuseStl(With(kAscii, "1 1 0", "1 nan 0"), {"line 6", "\"nan\"", "coordinate 2"});
  RefuseStl(With(kAscii, "1 1 0", "1e39 1 0"), {"line 6", "x = 1e+39"});
  RefuseStl(With(kAscii, "1 1 0", "1 1 0 0"), {"line 6", "\"0\" follows"});
  RefuseStl(With(kAscii, "ENDSOLID\n", "ENDSOLID\nhello\n"), {"line 19", "\"solid\" is expected, not \"hello\""});
}

TEST(StlReaderTest, RefusesMalformedBinary) {
  const std::string good = Binary("solid", kSquare);
  RefuseStl(good + "x", {"byte 80", "2 triangles take 184 bytes, but the file has 185"});
  RefuseStl(good.substr(0, 183), {"byte 80", "take 184 bytes, but the file has 183"});
  RefuseStl(std::string("\0\1\2", 3), {"byte 3", "84 bytes or more"});
  std::string lying = good;
  std::memset(lying.data() + 80, 0xFF, 4);
  RefuseStl(lying, {"byte 80", "4294967295 triangles take 214748364834 bytes"});
  std::vector<Facet> bad = kSquare;
  bad[1][2].y = std::numeric_limits<float>::infinity();
  RefuseStl(Binary("", bad), {"byte 134", "y = inf"});
  bad[1][2].y = NAN;
  RefuseStl(Binary("", bad), {"byte 134", "y = nan"});
}

TEST(StlReaderTest, EveryTruncationIsRefusedOrEndsASolid) {
  const std::string ascii = kAscii, binary = Binary("solid", kSquare);
  // Without the last line feed it is whole.
  for (size_t size = 0; size + 1 < ascii.size(); ++size) {
    const auto result = Read(ascii.substr(0, size), MeshFormat::kStl);
    // After "endsolid" of either solid, the file may end.
    const bool whole = ascii.substr(0, size).find("endsolid") != std::string::npos &&
                       ascii.substr(0, size).find("SOLID") == std::string::npos;
    if (whole) continue;
    EXPECT_EQ(result.status().code(), absl::StatusCode::kInvalidArgument) << size;
  }
  for (size_t size = 0; size < binary.size(); ++size) {
    EXPECT_EQ(Read(binary.substr(0, size), MeshFormat::kStl).status().code(), absl::StatusCode::kInvalidArgument)
        << size;
  }
}

TEST(StlReaderTest, HoldsToTheLimits) {
  MeshLimits limits;
  limits.max_triangles = 1;
  ExpectRefused(Binary("", kSquare), MeshFormat::kStl, absl::StatusCode::kResourceExhausted,
                {"byte 80", "2 triangles", "1 (--max-triangles)"}, limits);
  ExpectRefused(kAscii, MeshFormat::kStl, absl::StatusCode::kResourceExhausted, {"line 17", "1 (--max-triangles)"},
                limits);
  limits = {};
  limits.max_vertices = 3;
  ExpectRefused(Binary("", kSquare), MeshFormat::kStl, absl::StatusCode::kResourceExhausted,
                {"byte 134", "3 (--max-vertices)"}, limits);
  limits = {};
  limits.max_groups = 0;
  ExpectRefused(kAscii, MeshFormat::kStl, absl::StatusCode::kResourceExhausted, {"line 8", "0 (--max-groups)"}, limits);
}

}  // namespace
}  // namespace deltaray
