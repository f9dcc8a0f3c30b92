// Meshes whose right answers are known.

#ifndef TESTS_TORTURE_SUBJECT_H_
#define TESTS_TORTURE_SUBJECT_H_

#include <memory>
#include <string>
#include <vector>

#include "deltaray/v1/ray_service.pb.h"
#include "server/mesh/triangle_mesh.h"
#include "tests/bench/service_client.h"

namespace deltaray {

// Immutable, so thread-safe.
struct Subject {
  TriangleMesh mesh;
  std::string id;
  // By brute force, of each of the rays that all subjects are asked.
  std::vector<float> t;
  std::vector<uint32_t> primitive_ids;

  // Whether the answers to the rays from `first` on are the right ones, bit for bit.
  bool Accepts(const v1::HitBatch& hits, size_t first) const;
};

// Different meshes of different sizes, and the rays that they are asked, by which they can be told apart.
struct Subjects {
  std::vector<std::unique_ptr<const Subject>> meshes;
  WireRays rays;

  Subjects(int count, uint32_t ray_count);
};

}  // namespace deltaray

#endif  // TESTS_TORTURE_SUBJECT_H_
