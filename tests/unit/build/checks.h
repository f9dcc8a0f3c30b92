// What every tree that is built must hold to.

#ifndef TESTS_UNIT_BUILD_CHECKS_H_
#define TESTS_UNIT_BUILD_CHECKS_H_

#include <algorithm>
#include <span>
#include <vector>

#include "gtest/gtest.h"
#include "server/build/reference.h"
#include "server/geometry/triangle_test.h"
#include "server/tree/brute_force.h"
#include "server/tree/bvh.h"
#include "tests/scenes/hard_rays.h"
#include "tests/scenes/random.h"
#include "tests/scenes/rays.h"
#include "tests/scenes/shapes.h"

namespace deltaray {

// References with random boxes within the unit cube; primitive i is reference i.
inline std::vector<Reference> RandomReferences(uint32_t count, uint64_t seed, double size = 0.2) {
  Random random(seed);
  std::vector<Reference> references(count);
  for (uint32_t i = 0; i < count; ++i) {
    references[i].primitive = i;
    for (int axis = 0; axis < 3; ++axis) {
      const double min = random.Uniform(0, 1);
      references[i].bounds.min[axis] = static_cast<float>(min);
      references[i].bounds.max[axis] = static_cast<float>(min + random.Uniform(0, size));
    }
  }
  return references;
}

inline Bounds UnionOf(std::span<const Reference> references) {
  Bounds bounds;
  for (const Reference& reference : references) bounds.Extend(reference.bounds);
  return bounds;
}

inline bool Covers(const Bounds& bounds, Vec3f point) {
  Bounds with_point = bounds;
  with_point.Extend(point);
  return with_point == bounds;
}

// Nodes are in depth-first order, boxes nest, leaves' references follow each other without gaps, and each triangle that
// is not degenerate has each corner in the box of a leaf that has it.
inline void CheckBvh(const BvhArrays& arrays, const TrianglesView& triangles) {
  std::vector<std::array<bool, 3>> covered(triangles.size());
  uint32_t next_reference = 0;
  std::vector<uint32_t> second_children;
  for (uint32_t i = 0; i < arrays.nodes.size(); ++i) {
    const BvhNode& node = arrays.nodes[i];
    if (!node.IsLeaf()) {
      ASSERT_GT(node.offset, i + 1);
      ASSERT_LT(node.offset, arrays.nodes.size());
      EXPECT_TRUE(node.bounds.Contains(arrays.nodes[i + 1].bounds)) << i;
      EXPECT_TRUE(node.bounds.Contains(arrays.nodes[node.offset].bounds)) << i;
      second_children.push_back(node.offset);
      continue;
    }
    ASSERT_EQ(node.offset, next_reference) << i;
    next_reference += node.count;
    ASSERT_LE(next_reference, arrays.references.size());
    for (uint32_t r = node.offset; r < next_reference; ++r) {
      const uint32_t primitive = arrays.references[r];
      ASSERT_LT(primitive, triangles.size());
      const Triangle triangle = triangles[primitive];
      covered[primitive][0] |= Covers(node.bounds, triangle.v0);
      covered[primitive][1] |= Covers(node.bounds, triangle.v1);
      covered[primitive][2] |= Covers(node.bounds, triangle.v2);
    }
    // After a leaf comes the second child that is still open.
    if (i + 1 < arrays.nodes.size()) {
      ASSERT_FALSE(second_children.empty());
      ASSERT_EQ(second_children.back(), i + 1);
      second_children.pop_back();
    }
  }
  EXPECT_TRUE(second_children.empty());
  EXPECT_EQ(next_reference, arrays.references.size());
  for (size_t i = 0; i < triangles.size(); ++i) {
    if (IsDegenerate(triangles[i])) continue;
    EXPECT_TRUE(covered[i][0] && covered[i][1] && covered[i][2]) << "triangle " << i;
  }
}

// Chords and the rays on which ray tracers fail, about `count` of each.
inline std::vector<Ray> ChordsAndHardRays(const TriangleMesh& mesh, uint32_t count, uint64_t seed) {
  if (mesh.indices.empty()) return ChordRays(Bounds{{0, 0, 0}, {1, 1, 1}}, count, seed);
  std::vector<Ray> rays = ChordRays(MeshBounds(mesh), count, seed);
  for (const HardRays& family : HardRayFamilies()) {
    const std::vector<Ray> more = family.make(mesh, count, seed);
    rays.insert(rays.end(), more.begin(), more.end());
  }
  return rays;
}

// All that a tree says about some rays.
struct Answers {
  std::vector<Hit> closest, all;
  std::vector<uint8_t> any;
  std::vector<uint32_t> all_counts, counts;

  Answers(const Tree& tree, std::span<const Ray> rays)
      : closest(rays.size()), any(rays.size()), all_counts(rays.size()), counts(rays.size()) {
    const QueryOptions options{.max_hits_per_ray = 8};
    tree.ClosestHits(rays, options, closest);
    tree.AnyHits(rays, options, any);
    tree.AllHits(rays, options, &all, all_counts);
    tree.CountHits(rays, options, counts);
  }
  friend bool operator==(const Answers&, const Answers&) = default;
};

}  // namespace deltaray

#endif  // TESTS_UNIT_BUILD_CHECKS_H_
