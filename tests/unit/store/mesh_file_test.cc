#include "server/store/mesh_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <string>

#include "absl/strings/escaping.h"
#include "server/mesh/canonical.h"
#include "tests/unit/store/fixture.h"

namespace deltaray {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

TriangleMesh Mesh() {
  TriangleMesh mesh;
  mesh.positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  mesh.indices = {{0, 1, 2}, {0, 1, 3}, {1, 2, 3}};
  mesh.origin = {1e6, -0.5, 3};
  mesh.face_ids = {0, 0, 1};
  mesh.group_ids = {0, 1, kNoGroup};
  mesh.groups = {"first", "second"};
  mesh.face_count = 2;
  return mesh;
}

MeshInfo Info(const TriangleMesh& mesh) {
  MeshInfo info;
  info.vertex_count = mesh.positions.size();
  info.triangle_count = mesh.indices.size();
  info.face_count = mesh.face_count;
  info.origin = mesh.origin;
  info.groups = mesh.groups;
  info.report.degenerate_triangles = 5;
  info.report.max_rounding = 0.1;
  info.report.bounds = {{0, 0, 0}, {1, 1, 1}};
  info.report.warnings = {"line 3: odd", ""};
  info.created = std::chrono::system_clock::time_point(std::chrono::microseconds(1234567890123456));
  return info;
}

class MeshFileTest : public ::testing::Test {
 protected:
  MeshFileTest() : path_(directory_.path() + "/x.mesh") {
    absl::StatusOr<TemporaryFile> file = TemporaryFile::Create(directory_.path());
    digest_ = *DigestMesh(Mesh());
    EXPECT_TRUE(WriteMeshFile(Mesh(), digest_, Info(Mesh()), &*file).ok());
    EXPECT_TRUE(file->Sync().ok());
    EXPECT_TRUE(file->MoveTo(path_).ok());
    id_ = absl::BytesToHexString(digest_.sha256);
    content_ = ReadFile(path_);
  }

  // The error of what serves the mesh: whichever of both ways to read the file fails first.
  absl::Status ErrorOf(const std::string& content) {
    WriteFile(path_, content);
    const absl::Status info = ReadMeshFileInfo(path_).status();
    const absl::Status mesh = ReadMeshFile(path_, id_, [] { return false; }).status();
    EXPECT_FALSE(!info.ok() && mesh.ok()) << "the mesh is served though its metadata is damaged";
    return mesh;
  }

  ScratchDirectory directory_;
  std::string path_, id_, content_;
  MeshDigest digest_;
};

TEST_F(MeshFileTest, ComesBack) {
  EXPECT_EQ(id_, MeshId(Mesh()));
  EXPECT_EQ(MeshFileBytes(digest_, Info(Mesh())), content_.size());
  const absl::StatusOr<MeshInfo> info = ReadMeshFileInfo(path_);
  ASSERT_TRUE(info.ok()) << info.status();
  const MeshInfo written = Info(Mesh());
  EXPECT_EQ(info->id, id_);
  EXPECT_EQ(info->vertex_count, written.vertex_count);
  EXPECT_EQ(info->triangle_count, written.triangle_count);
  EXPECT_EQ(info->face_count, written.face_count);
  EXPECT_EQ(info->origin, written.origin);
  EXPECT_THAT(info->groups, IsEmpty());
  EXPECT_EQ(*ReadMeshFileGroups(path_, id_), written.groups);
  EXPECT_EQ(info->report.degenerate_triangles, 5u);
  EXPECT_EQ(info->report.max_rounding, 0.1);
  EXPECT_EQ(info->report.bounds, written.report.bounds);
  EXPECT_EQ(info->report.warnings, written.report.warnings);
  EXPECT_EQ(info->created, written.created);
  EXPECT_EQ(info->stored_bytes, content_.size());

  const absl::StatusOr<TriangleMesh> mesh = ReadMeshFile(path_, id_, [] { return false; });
  ASSERT_TRUE(mesh.ok()) << mesh.status();
  EXPECT_EQ(MeshId(*mesh), id_);
  EXPECT_EQ(mesh->positions, Mesh().positions);
  EXPECT_EQ(mesh->indices, Mesh().indices);
}

TEST_F(MeshFileTest, IsLaidOutAsDocumented) {
  const auto number = [&](size_t offset, auto value) {
    std::memcpy(&value, content_.data() + offset, sizeof(value));
    return value;
  };
  EXPECT_EQ(content_.substr(0, 8), "DRMESH\r\n");
  EXPECT_EQ(number(8, uint32_t{}), 1u);
  const uint32_t metadata_bytes = number(12, uint32_t{});
  EXPECT_EQ(number(16, uint64_t{}), digest_.bytes);
  EXPECT_EQ(content_.substr(24, 32), digest_.sha256);
  EXPECT_EQ(content_.size(), 88 + metadata_bytes + digest_.bytes);
  EXPECT_EQ(number(88, int64_t{}), 1234567890123456);
  EXPECT_EQ(number(96, uint64_t{}), 4u);
  EXPECT_EQ(number(104, uint64_t{}), 3u);
  EXPECT_EQ(number(112, uint64_t{}), 2u);
  EXPECT_EQ(number(120, uint64_t{}), 5u);
  EXPECT_EQ(number(128, double{}), 0.1);
  EXPECT_EQ(number(136, double{}), 1e6);
  EXPECT_EQ(number(160, float{}), 0);
  EXPECT_EQ(number(172, float{}), 1);
  EXPECT_EQ(number(184, uint32_t{}), 2u);  // warnings
  EXPECT_EQ(number(188, uint32_t{}), 11u);
  EXPECT_EQ(content_.substr(192, 11), "line 3: odd");
}

TEST_F(MeshFileTest, EveryTruncationIsDataLoss) {
  for (size_t size = 0; size < content_.size(); ++size) {
    const absl::Status status = ErrorOf(content_.substr(0, size));
    ASSERT_EQ(status.code(), absl::StatusCode::kDataLoss) << size << " " << status;
    EXPECT_THAT(status.ToString(), HasSubstr(path_));
    EXPECT_FALSE(ReadMeshFileInfo(path_).ok()) << size;
  }
}

TEST_F(MeshFileTest, TrailingBytesAreDataLoss) {
  const absl::Status status = ErrorOf(content_ + '\0');
  EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(status.ToString(), HasSubstr("trailing"));
}

TEST_F(MeshFileTest, EveryFlippedBitIsNoticed) {
  for (size_t bit = 0; bit < 8 * content_.size(); ++bit) {
    std::string flipped = content_;
    flipped[bit / 8] ^= static_cast<char>(1 << bit % 8);
    const absl::Status status = ErrorOf(flipped);
    ASSERT_FALSE(status.ok()) << bit;
    EXPECT_THAT(status.ToString(), HasSubstr(path_));
    // All but the geometry is checked without reading it.
    const bool in_payload = bit / 8 >= content_.size() - digest_.bytes;
    ASSERT_EQ(ReadMeshFileInfo(path_).ok(), in_payload) << bit;
    // An id that was changed is noticed where it is known.
    ASSERT_EQ(ReadMeshFileGroups(path_, id_).ok(), in_payload) << bit;
  }
}

TEST_F(MeshFileTest, ANewerVersionIsRefusedByName) {
  std::string newer = content_;
  newer[8] = 2;
  const absl::Status status = ErrorOf(newer);
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(status.ToString(), HasSubstr("version 2"));
}

TEST_F(MeshFileTest, AnotherMeshsFileIsNotTaken) {
  const absl::Status status = ReadMeshFile(path_, std::string(64, '0'), [] { return false; }).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(status.ToString(), HasSubstr("another id"));
  EXPECT_EQ(ReadMeshFileGroups(path_, std::string(64, '0')).status(), status);
}

TEST_F(MeshFileTest, ReadingCanBeCancelled) {
  EXPECT_EQ(ReadMeshFile(path_, id_, [] { return true; }).status().code(), absl::StatusCode::kCancelled);
}

TEST_F(MeshFileTest, AMissingFileIsNotFound) {
  EXPECT_EQ(ReadMeshFileInfo(path_ + "x").status().code(), absl::StatusCode::kNotFound);
}

TEST_F(MeshFileTest, AFolderIsNoMeshFile) {
  EXPECT_EQ(ReadMeshFileInfo(directory_.path()).status().code(), absl::StatusCode::kDataLoss);
}

}  // namespace
}  // namespace deltaray
