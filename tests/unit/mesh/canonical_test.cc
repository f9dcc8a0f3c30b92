#include "server/mesh/canonical.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

namespace deltaray {
namespace {

TriangleMesh TwoTriangles() {
  TriangleMesh mesh;
  mesh.positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 1e-40f}};
  mesh.indices = {{0, 1, 2}, {1, 3, 2}};
  mesh.origin = {500000, 0, 5400000};
  mesh.face_ids = {0, 0};
  mesh.group_ids = {1, kNoGroup};
  mesh.groups = {"left", "rechts \xC3\xBC"};
  mesh.face_count = 1;
  return mesh;
}

std::string Canonical(const TriangleMesh& mesh) {
  std::string bytes;
  EXPECT_TRUE(WriteCanonical(mesh, [&](absl::string_view piece) {
                bytes.append(piece.data(), piece.size());
                return absl::OkStatus();
              }).ok());
  return bytes;
}

TEST(CanonicalTest, ReadsBackWhatWasWritten) {
  const TriangleMesh mesh = TwoTriangles();
  const auto read = ReadCanonical(Canonical(mesh));
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(read->positions, mesh.positions);
  EXPECT_EQ(read->indices, mesh.indices);
  EXPECT_EQ(read->origin, mesh.origin);
  EXPECT_EQ(read->face_ids, mesh.face_ids);
  EXPECT_EQ(read->group_ids, mesh.group_ids);
  EXPECT_EQ(read->groups, mesh.groups);
  EXPECT_EQ(read->face_count, mesh.face_count);
}

TEST(CanonicalTest, ReadsBackAnEmptyMesh) {
  const auto read = ReadCanonical(Canonical(TriangleMesh()));
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_TRUE(read->indices.empty());
}

// The layout is a promise: files of earlier versions, and ids that clients keep, depend on it. The sums are from a
// writer of the layout in the folder's README in Python.
TEST(CanonicalTest, LayoutStaysTheSame) {
  EXPECT_EQ(Canonical(TwoTriangles()).size(), 72u + 4 * 12 + 2 * 12 + 2 * 4 + 2 * 4 + (4 + 4) + (4 + 9));
  EXPECT_EQ(MeshId(TwoTriangles()), "8b99efcd42e62fda233d8fcb89f7228d63b8e7f0ed94d7cd21fb7b45ba7aadf6");
  EXPECT_EQ(MeshId(TriangleMesh()), "18b4f3232f04c07b3a1ae39e5b50b4463000b20415112bc919392c5e2cd9fe05");
}

TEST(CanonicalTest, SameGeometryHasTheSameId) {
  TriangleMesh a = TwoTriangles();
  a.group_ids = {kNoGroup, kNoGroup};
  a.face_ids = {0, 1};
  a.face_count = 2;
  TriangleMesh b = a;
  b.group_ids.clear();
  b.face_ids.clear();
  b.positions[0].x = -0.0f;
  b.origin.y = -0.0;
  EXPECT_EQ(MeshId(a), MeshId(b));
}

TEST(CanonicalTest, EveryPartCountsForTheId) {
  const TriangleMesh mesh = TwoTriangles();
  std::vector<std::string> ids = {MeshId(mesh)};
  const auto add = [&](const auto& change) {
    TriangleMesh other = mesh;
    change(other);
    ids.push_back(MeshId(other));
  };
  add([](TriangleMesh& m) { m.positions[3].z = 0; });
  add([](TriangleMesh& m) { m.indices[1] = {3, 2, 1}; });
  add([](TriangleMesh& m) { m.origin.z = 0; });
  add([](TriangleMesh& m) { m.face_count = 2; });
  add([](TriangleMesh& m) { m.face_ids = {0, 1}; });
  add([](TriangleMesh& m) { m.group_ids = {0, kNoGroup}; });
  add([](TriangleMesh& m) { m.groups = {"lef", "trechts \xC3\xBC"}; });
  for (size_t i = 0; i < ids.size(); ++i) {
    EXPECT_THAT(ids[i], testing::MatchesRegex("[0-9a-f]{64}"));
    for (size_t j = 0; j < i; ++j) EXPECT_NE(ids[i], ids[j]) << i << " " << j;
  }
}

TEST(CanonicalTest, StopsAtTheFirstErrorOfTheSink) {
  int calls = 0;
  const absl::Status status = WriteCanonical(TwoTriangles(), [&](absl::string_view) {
    return ++calls == 3 ? absl::UnavailableError("disk full") : absl::OkStatus();
  });
  EXPECT_EQ(status, absl::UnavailableError("disk full"));
  EXPECT_EQ(calls, 3);
}

TEST(CanonicalTest, RefusesEveryTruncation) {
  const std::string bytes = Canonical(TwoTriangles());
  for (size_t size = 0; size < bytes.size(); ++size) {
    EXPECT_EQ(ReadCanonical({bytes.data(), size}).status().code(), absl::StatusCode::kDataLoss) << size;
  }
  EXPECT_EQ(ReadCanonical(bytes + "x").status().code(), absl::StatusCode::kDataLoss);
}

TEST(CanonicalTest, RefusesEachBrokenInvariant) {
  const auto text = [](const auto& change) {
    TriangleMesh mesh = TwoTriangles();
    change(mesh);
    const absl::Status status = ReadCanonical(Canonical(mesh)).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss);
    return std::string(status.message());
  };
  using testing::HasSubstr;
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THAT(text([](TriangleMesh& m) { m.indices[1][2] = 4; }), HasSubstr("triangle 1 has index 4"));
  EXPECT_THAT(text([](TriangleMesh& m) { m.positions[2].y = kNan; }), HasSubstr("vertex 2 is not finite"));
  EXPECT_THAT(text([](TriangleMesh& m) { m.origin.x = INFINITY; }), HasSubstr("origin is not finite"));
  EXPECT_THAT(text([](TriangleMesh& m) { m.face_ids[1] = 1; }), HasSubstr("triangle 1 has face 1"));
  EXPECT_THAT(text([](TriangleMesh& m) { m.group_ids[0] = 2; }), HasSubstr("triangle 0 has group 2"));
  EXPECT_THAT(text([](TriangleMesh& m) { m.groups[0] = "\xFF"; }), HasSubstr("group 0 is not printable"));
  EXPECT_THAT(text([](TriangleMesh& m) { m.face_count = uint64_t{1} << 31; }), HasSubstr("2^31"));
}

TEST(CanonicalTest, RandomDamageIsRefusedOrHarmless) {
  std::mt19937 random(7);
  const std::string bytes = Canonical(TwoTriangles());
  for (int round = 0; round < 20000; ++round) {
    std::string damaged = bytes;
    for (int i = 0; i < 1 + round % 3; ++i) damaged[random() % damaged.size()] = static_cast<char>(random());
    const auto read = ReadCanonical(damaged);
    if (!read.ok()) continue;
    for (const auto& corners : read->indices) {
      for (const uint32_t corner : corners) ASSERT_LT(corner, read->positions.size());
    }
  }
}

}  // namespace
}  // namespace deltaray
