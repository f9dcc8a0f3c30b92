// Small meshes with answers that can be worked out by hand, and a snapshot of them.

#ifndef TESTS_UNIT_SERVICE_MESHES_H_
#define TESTS_UNIT_SERVICE_MESHES_H_

#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "deltaray/v1/ray_service.pb.h"
#include "grpcpp/support/slice.h"
#include "gtest/gtest.h"
#include "server/build/build.h"
#include "server/mesh/triangle_mesh.h"
#include "server/tree/brute_force.h"

namespace deltaray {

// Squares of two triangles, [0,1] × [0,1], at z = 0, 1, ... count - 1, seen counter-clockwise from +z. Triangles 2i and
// 2i + 1 are of face i; face 0 is in no group, all others are in group 0.
inline TriangleMesh Squares(uint32_t count) {
  TriangleMesh mesh;
  for (uint32_t i = 0; i < count; ++i) {
    const auto z = static_cast<float>(i);
    for (Vec3f corner : {Vec3f{0, 0, z}, {1, 0, z}, {1, 1, z}, {0, 1, z}}) mesh.positions.push_back(corner);
    mesh.indices.push_back({4 * i, 4 * i + 1, 4 * i + 2});
    mesh.indices.push_back({4 * i, 4 * i + 2, 4 * i + 3});
    mesh.face_ids.insert(mesh.face_ids.end(), 2, i);
    mesh.group_ids.insert(mesh.group_ids.end(), 2, i == 0 ? kNoGroup : 0);
  }
  mesh.groups = {"upper"};
  mesh.face_count = count;
  return mesh;
}

// A snapshot that answers by brute force.
inline std::shared_ptr<const TreeSnapshot> BruteForceSnapshot(TriangleMesh mesh, bool final = true) {
  struct Owner {
    TriangleMesh mesh;
    BruteForce tree;
    explicit Owner(TriangleMesh m) : mesh(std::move(m)), tree(mesh.triangles()) {}
  };
  auto owner = std::make_shared<Owner>(std::move(mesh));
  auto snapshot = std::make_shared<TreeSnapshot>();
  snapshot->mesh = {owner, &owner->mesh};
  snapshot->tree = {owner, &owner->tree};
  snapshot->final = final;
  return snapshot;
}

// The message in the bytes of a reply.
inline v1::HitBatch ToHitBatch(const grpc::Slice& bytes) {
  v1::HitBatch batch;
  EXPECT_TRUE(batch.ParseFromArray(bytes.begin(), static_cast<int>(bytes.size())));
  // Every field in the form and order in which protobuf writes it.
  EXPECT_EQ(batch.SerializeAsString(), std::string(bytes.begin(), bytes.end()));
  return batch;
}

// Numbers as they travel.
template <typename Number>
std::string Bytes(const std::vector<Number>& numbers) {
  return {reinterpret_cast<const char*>(numbers.data()), numbers.size() * sizeof(Number)};
}

template <typename Number>
std::vector<Number> Numbers(const std::string& bytes) {
  std::vector<Number> numbers(bytes.size() / sizeof(Number));
  std::memcpy(numbers.data(), bytes.data(), bytes.size());
  return numbers;
}

// `count` rays from (0.25, 0.5, height) downwards, as they travel: t to the square at z is height - z.
inline std::string RaysDownwards(size_t count, float height = 100) {
  std::vector<float> rays;
  for (size_t i = 0; i < count; ++i) {
    for (float number : {0.25f, 0.5f, height, 0.0f, 0.0f, -1.0f}) rays.push_back(number);
  }
  return Bytes(rays);
}

}  // namespace deltaray

#endif  // TESTS_UNIT_SERVICE_MESHES_H_
