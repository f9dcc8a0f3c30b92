// Short ways to read a mesh in tests.

#ifndef TESTS_UNIT_MESH_READ_H_
#define TESTS_UNIT_MESH_READ_H_

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "server/mesh/read_mesh.h"

namespace deltaray {

inline absl::StatusOr<ReadMeshResult> Read(const std::string& bytes, MeshFormat format = MeshFormat::kDetect,
                                           const MeshLimits& limits = {}) {
  ReadMeshOptions options;
  options.format = format;
  options.limits = limits;
  return ReadMesh(bytes, options);
}

// Expects that reading fails with `code` and a text that has all of `parts` in it.
inline void ExpectRefused(const std::string& bytes, MeshFormat format, absl::StatusCode code,
                          const std::vector<std::string>& parts, const MeshLimits& limits = {}) {
  const absl::Status status = Read(bytes, format, limits).status();
  EXPECT_EQ(status.code(), code) << status << "\nfor:\n" << bytes.substr(0, 300);
  for (const std::string& part : parts) {
    EXPECT_THAT(std::string(status.message()), testing::HasSubstr(part)) << "for:\n" << bytes.substr(0, 300);
  }
}

// `text` with `from` replaced by `to`.
inline std::string With(std::string text, const std::string& from, const std::string& to) {
  const size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

using Corners = std::array<uint32_t, 3>;

}  // namespace deltaray

#endif  // TESTS_UNIT_MESH_READ_H_
