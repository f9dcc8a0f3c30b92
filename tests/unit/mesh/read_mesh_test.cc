#include "server/mesh/read_mesh.h"

#include <cctype>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>

#include "server/mesh/canonical.h"
#include "tests/unit/mesh/read.h"

namespace deltaray {
namespace {

using testing::HasSubstr;

constexpr char kObj[] =
    "o part\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.25 0.25 1\nf 1 2 3 4\ng other\nf 1/1 2//2 5/3/3\n";
constexpr char kPly[] =
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n"
    "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n";
constexpr char kStl[] =
    "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 1 1 0\nendloop\nendfacet\nendsolid "
    "a\n";

std::string Contents(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

void ExpectInvariants(const TriangleMesh& mesh) {
  for (const Vec3f& position : mesh.positions) {
    ASSERT_TRUE(IsFinite(position) && IsFinite(static_cast<Vec3d>(position) + mesh.origin));
  }
  for (size_t i = 0; i < mesh.indices.size(); ++i) {
    for (const uint32_t index : mesh.indices[i]) ASSERT_LT(index, mesh.positions.size());
    ASSERT_LT(mesh.FaceId(i), mesh.face_count);
    ASSERT_TRUE(mesh.GroupId(i) == kNoGroup || mesh.GroupId(i) < mesh.groups.size());
  }
  ASSERT_TRUE(mesh.face_ids.empty() || mesh.face_ids.size() == mesh.indices.size());
  ASSERT_TRUE(mesh.group_ids.empty() || mesh.group_ids.size() == mesh.indices.size());
}

TEST(ReadMeshTest, TellsFormatsByTheirContent) {
  const auto format = [](const std::string& text) {
    const auto result = Read(text);
    EXPECT_TRUE(result.ok()) << result.status();
    return result.ok() ? result->format : MeshFormat::kDetect;
  };
  EXPECT_EQ(format(kObj), MeshFormat::kObj);
  EXPECT_EQ(format(std::string("\xEF\xBB\xBF\r\n# ply\n\n  # solid\n  \t") + kObj), MeshFormat::kObj);
  EXPECT_EQ(format("mtllib a.mtl\nv 0 0 0\n"), MeshFormat::kObj);
  EXPECT_EQ(format("vn 0 0 1\nv 0 0 0\n"), MeshFormat::kObj);
  EXPECT_EQ(format(kPly), MeshFormat::kPly);
  EXPECT_EQ(format(kStl), MeshFormat::kStl);
  EXPECT_EQ(format(std::string("\n\n") + kStl), MeshFormat::kStl);
  EXPECT_EQ(format(std::string(84, '\0')), MeshFormat::kStl);
}

TEST(ReadMeshTest, RefusesWhatItCanNotTell) {
  const auto code = absl::StatusCode::kInvalidArgument;
  ExpectRefused("", MeshFormat::kDetect, code, {"byte 0", "empty"});
  ExpectRefused("\n# x\n\n", MeshFormat::kDetect, code, {"line 3", "nothing but blank lines and comments"});
  ExpectRefused("hello\n", MeshFormat::kDetect, code, {"line 1", "cannot be told", "\"hello\""});
  ExpectRefused("plywood\n", MeshFormat::kDetect, code, {"line 1", "cannot be told"});
  ExpectRefused(std::string("\x89PNG\r\n\x1A\n\0", 9), MeshFormat::kDetect, code, {"\"\\x89PNG\""});
  ExpectRefused(std::string(80, 'x') + std::string("\2\0\0\0", 4) + std::string(50, '\0'), MeshFormat::kDetect, code,
                {"cannot be told", "a binary STL file it would have 184 bytes, not 134"});
  ExpectRefused("\xFF\xFEv\0 \0", MeshFormat::kDetect, code, {"byte 0", "UTF-16"});
  ExpectRefused(std::string(2'000'000, 'x'), MeshFormat::kDetect, absl::StatusCode::kResourceExhausted,
                {"line 1", "1048576 (--max-line-bytes)"});
}

TEST(ReadMeshTest, TellsWhereAnotherFormatWasMeant) {
  const auto code = absl::StatusCode::kInvalidArgument;
  ExpectRefused(kStl, MeshFormat::kPly, code, {"line 1: ", "; it was read as PLY, but looks like STL"});
  ExpectRefused(kPly, MeshFormat::kObj, code, {"; it was read as OBJ, but looks like PLY"});
  ExpectRefused(kObj, MeshFormat::kStl, code, {"; it was read as STL, but looks like OBJ"});
  constexpr uint32_t kTriangles = 40'000;
  std::string binary(84 + 50 * kTriangles, '\0');
  std::memcpy(binary.data() + 80, &kTriangles, sizeof(kTriangles));
  ExpectRefused(binary, MeshFormat::kPly, absl::StatusCode::kResourceExhausted,
                {"line 1: the line has 2000084 bytes", "; it was read as PLY, but looks like STL"});
  EXPECT_THAT(std::string(Read("ply\n", MeshFormat::kPly).status().message()), testing::Not(HasSubstr("looks like")));
}

TEST(ReadMeshTest, CanBeCancelled) {
  std::string text = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
  for (int i = 0; i < 20000; ++i) text += "f 1 2 3\n";
  ReadMeshOptions options;
  int calls = 0;
  options.cancelled = [&] { return ++calls > 1000; };
  ASSERT_TRUE(ReadMesh(text, options).ok());
  const int all = calls;
  ASSERT_GT(all, 5);
  // Whenever it is asked, also in the last steps.
  for (int stop = 1; stop <= all; ++stop) {
    calls = 0;
    options.cancelled = [&] { return ++calls >= stop; };
    EXPECT_EQ(ReadMesh(text, options).status().code(), absl::StatusCode::kCancelled) << stop;
    EXPECT_EQ(calls, stop);
  }
}

TEST(ReadMeshTest, MeshesFarFromZeroKeepTheirPrecision) {
  // A terrain tile in UTM coordinates, in metres.
  std::string text;
  std::vector<Vec3d> given;
  std::mt19937 random(1);
  for (int i = 0; i < 1000; ++i) {
    char line[100];
    Vec3d v{500000.123 + random() % 1000000 * 1e-3, 5400000.456 + random() % 1000000 * 1e-3, random() % 100000 * 1e-3};
    std::snprintf(line, sizeof(line), "v %.3f %.3f %.3f\n", v.x, v.y, v.z);
    text += line;
    for (int axis = 0; axis < 3; ++axis) v[axis] = std::round(v[axis] * 1000) / 1000;
    given.push_back(v);
    if (i >= 2) text += "f -1 -2 -3\n";
  }
  const auto result = Read(text);
  ASSERT_TRUE(result.ok()) << result.status();
  const TriangleMesh& mesh = result->mesh;
  EXPECT_EQ(mesh.origin, (Vec3d{500736, 5400576, 0}));
  double worst = 0;
  for (size_t i = 0; i < given.size(); ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      worst = std::max(worst, std::abs(mesh.origin[axis] + mesh.positions[i][axis] - given[i][axis]));
    }
  }
  EXPECT_LT(worst, 1e-4);
  EXPECT_NEAR(result->report.max_rounding, worst, 1e-9);
  EXPECT_GT(result->report.max_rounding, 1e-6);
}

TEST(ReadMeshTest, ReportsBoundsAndDegenerateTriangles) {
  const auto result = Read("v 0 0 0\nv 2 0 0\nv 0 3 0\nv 1 0 0\nv 0 0 -9\nf 1 2 3\nf 1 2 4\nf 1 1 2\n");
  ASSERT_TRUE(result.ok());
  EXPECT_EQ(result->report.degenerate_triangles, 2u);
  EXPECT_EQ(result->mesh.indices.size(), 3u);
  EXPECT_EQ(result->report.bounds, (Bounds{{0, 0, -9}, {2, 3, 0}}));
  EXPECT_THAT(result->report.warnings, testing::ElementsAre(HasSubstr("2 of 3 triangles have no area")));
}

TEST(ReadMeshTest, WarnsOfPolygonsThatAreNotSimple) {
  const auto result = Read("v 0 0 0\nv 1 1 0\nv 1 0 0\nv 0 1 0\nf 1 3 2\nf 1 2 3 4\n");
  ASSERT_TRUE(result.ok());
  EXPECT_EQ(result->mesh.indices.size(), 3u);
  EXPECT_THAT(result->report.warnings, testing::ElementsAre(HasSubstr("Face 1 of 4 corners is not a simple polygon")));
}

TEST(ReadMeshTest, TheSameGeometryHasTheSameIdInEveryFormat) {
  const std::string obj = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n";
  const std::vector<float> positions = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, -0.0f};
  const std::vector<uint32_t> indices = {0, 1, 2, 0, 2, 3};
  const std::string raw = std::string(reinterpret_cast<const char*>(positions.data()), 48) +
                          std::string(reinterpret_cast<const char*>(indices.data()), 24);
  ReadMeshOptions options;
  options.format = MeshFormat::kRaw;
  options.raw = {4, 2, false};
  const std::string id = MeshId(ReadMesh(raw, options)->mesh);
  EXPECT_EQ(MeshId(Read(obj)->mesh), id);
  EXPECT_EQ(MeshId(Read(kPly)->mesh), id);
}

TEST(ReadMeshTest, EveryTruncationLoadsOrNamesItsPlace) {
  for (const std::string text : {kObj, kPly, kStl}) {
    for (size_t size = 0; size <= text.size(); ++size) {
      const auto result = Read(text.substr(0, size));
      if (result.ok()) {
        ExpectInvariants(result->mesh);
      } else {
        EXPECT_EQ(result.status().code(), absl::StatusCode::kInvalidArgument);
        EXPECT_THAT(std::string(result.status().message()), testing::ContainsRegex("^(line|byte) [0-9]+: "));
      }
    }
  }
}

// Small damage anywhere: bytes changed, left out, doubled; pieces of the file or hostile words put in.
TEST(ReadMeshTest, RandomDamageNeverCrashes) {
  const char* const words[] = {"-1",      "0",         "99999999999", "nan", "1e999",      "/",
                               "//",      "\\\n",      "\n",          "\r",  " ",          "#",
                               "f ",      "v ",        "g ",          "3 ",  "4294967295", "element face 9\n",
                               "solid\n", "endsolid\n"};
  std::string binary =
      "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty double y\n"
      "property int z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";
  for (int i = 0; i < 3 * 16 + 13; ++i)
    binary += static_cast<char>(i == 48 ? 3 : i >= 49 && i % 4 == 1 ? (i - 49) / 4 : 0);
  ASSERT_TRUE(Read(binary).ok()) << Read(binary).status();
  std::string binary_stl(84 + 50, '\0');
  binary_stl[80] = 1;
  ASSERT_TRUE(Read(binary_stl).ok());
  const std::pair<std::string, MeshFormat> seeds[] = {{kObj, MeshFormat::kObj},
                                                      {kPly, MeshFormat::kPly},
                                                      {kStl, MeshFormat::kStl},
                                                      {binary, MeshFormat::kPly},
                                                      {binary_stl, MeshFormat::kStl}};
  std::mt19937 random(1);
  int good = 0, bad = 0;
  for (int round = 0; round < 30000; ++round) {
    const auto& [seed, format] = seeds[round % std::size(seeds)];
    std::string text = seed;
    for (int change = random() % 4; change >= 0; --change) {
      const size_t at = random() % (text.size() + 1), length = std::min<size_t>(random() % 8, text.size() - at);
      switch (random() % 5) {
        case 0:
          if (at < text.size()) text[at] = static_cast<char>(random());
          break;
        case 1:
          text.erase(at, length);
          break;
        case 2:
          text.insert(at, text.substr(at, length));
          break;
        case 3:
          text.insert(at, words[random() % std::size(words)]);
          break;
        case 4:
          text.replace(at, length, words[random() % std::size(words)]);
          break;
      }
    }
    const auto result = Read(text, round % 2 ? format : MeshFormat::kDetect);
    if (result.ok()) {
      ++good;
      ExpectInvariants(result->mesh);
      ASSERT_LE(result->mesh.indices.size(), text.size());
    } else {
      ++bad;
      ASSERT_TRUE(result.status().code() == absl::StatusCode::kInvalidArgument ||
                  result.status().code() == absl::StatusCode::kResourceExhausted)
          << result.status();
      ASSERT_THAT(std::string(result.status().message()), testing::ContainsRegex("^(line|byte) [0-9]+: "));
    }
  }
  EXPECT_GT(good, 1000);
  EXPECT_GT(bad, 1000);
}

TEST(ReadMeshTest, LoadsTheTestModelsOfAssimpOrSaysWhyNot) {
  const std::filesystem::path root = "/usr/share/assimp/models";
  if (!std::filesystem::exists(root)) GTEST_SKIP() << "the package assimp-testmodels is not installed";
  int loaded = 0;
  std::vector<std::string> refused;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(root)) {
    std::string extension = entry.path().extension();
    for (char& c : extension) c = std::tolower(c);
    if (extension != ".obj" && extension != ".ply" && extension != ".stl") continue;
    const auto result = Read(Contents(entry.path()));
    if (result.ok()) {
      ++loaded;
      ExpectInvariants(result->mesh);
    } else {
      refused.push_back(entry.path().filename());
      EXPECT_EQ(result.status().code(), absl::StatusCode::kInvalidArgument) << entry.path();
      EXPECT_THAT(std::string(result.status().message()), testing::ContainsRegex("^(line|byte) [0-9]+: "))
          << entry.path();
    }
  }
  // A number "3.1+e2"; UTF-16; comments without "comment"; a list among the properties of a vertex; bytes that a change
  // of line ends took away; and the four that are meant to be bad.
  EXPECT_THAT(refused,
              testing::UnorderedElementsAre("number_formats.obj", "box_UTF16BE.obj", "Wuson.ply", "issue623.ply",
                                            "pond.0.ply", "empty.obj", "empty.ply", "malformed.obj", "malformed2.obj"));
  EXPECT_EQ(loaded, 33);
}

TEST(ReadMeshTest, LoadsTheBunny) {
  const std::filesystem::path path = "/usr/share/glmark2/models/bunny.obj";
  if (!std::filesystem::exists(path)) GTEST_SKIP() << "the package glmark2-data is not installed";
  const auto result = Read(Contents(path));
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->mesh.indices.size(), 69666u);
  EXPECT_EQ(result->mesh.positions.size(), 34835u);
  EXPECT_EQ(result->mesh.origin, (Vec3d{0, 0, 0}));
  EXPECT_LT(result->report.max_rounding, 1e-7);
  EXPECT_EQ(result->report.degenerate_triangles, 0u);
}

}  // namespace
}  // namespace deltaray
