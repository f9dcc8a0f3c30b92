// Small scenes, and trees over them that are built in the simplest way, for tests of the trees alone.

#ifndef TESTS_UNIT_TREE_SMALL_TREES_H_
#define TESTS_UNIT_TREE_SMALL_TREES_H_

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <numeric>
#include <span>
#include <utility>
#include <vector>

#include "gtest/gtest.h"
#include "server/geometry/clip_triangle.h"
#include "server/tree/brute_force.h"
#include "server/tree/bvh.h"
#include "server/tree/kd_tree.h"
#include "tests/scenes/random.h"

namespace deltaray {

struct SmallScene {
  std::vector<Vec3f> positions;
  std::vector<std::array<uint32_t, 3>> indices;

  TrianglesView view() const { return {positions, indices}; }
  void Add(const Triangle& t) {
    const auto first = static_cast<uint32_t>(positions.size());
    positions.insert(positions.end(), {t.v0, t.v1, t.v2});
    indices.push_back({first, first + 1, first + 2});
  }
};

// Integers from 0 to `size` - 1.
inline Vec3f GridPoint(Random& random, uint32_t size) {
  const auto x = static_cast<float>(random.Below(size));
  const auto y = static_cast<float>(random.Below(size));
  const auto z = static_cast<float>(random.Below(size));
  return {x, y, z};
}

// Triangles with corners on a grid: many meet in corners, edges and planes; some coincide, some are degenerate.
inline SmallScene GridScene(uint32_t triangles, uint64_t seed) {
  Random random(seed);
  SmallScene scene;
  for (uint32_t i = 0; i < triangles; ++i) {
    const Vec3f corner = GridPoint(random, 6);
    const Triangle t{corner, corner + GridPoint(random, 3), corner + GridPoint(random, 3)};
    scene.Add(t);
    if (i % 10 == 0) scene.Add(t);
  }
  return scene;
}

// Rays on the grid, along axes with ±0 too, from corners of the scene and from outside; some with ends at integers,
// some that exclude a triangle, some that can hit nothing.
inline std::vector<Ray> GridRays(const SmallScene& scene, uint32_t count, uint64_t seed) {
  Random random(seed);
  std::vector<Ray> rays(count);
  for (uint32_t i = 0; i < count; ++i) {
    Ray& ray = rays[i];
    ray.origin = i % 3 == 0 ? GridPoint(random, 8) : 2.0f * GridPoint(random, 8) - Vec3f{4, 4, 4.5f};
    ray.direction = i % 2 == 0 ? GridPoint(random, 3) - Vec3f{1, 1, 1} : GridPoint(random, 8) - ray.origin;
    if (i % 4 == 1) {
      ray.direction = {0, -0.0f, 0};
      ray.direction[static_cast<int>(random.Below(3))] = random.Below(2) == 0 ? 1.0f : -0.5f;
    }
    if (i % 5 == 0) ray.t_min = -std::numeric_limits<float>::infinity();
    if (i % 7 == 0) ray.t_max = static_cast<float>(random.Below(6));
    if (i % 3 == 1) ray.excluded_primitive = random.Below(static_cast<uint32_t>(scene.indices.size()));
  }
  return rays;
}

// A part of a triangle.
struct PartReference {
  uint32_t primitive;
  Bounds bounds;
};

inline std::vector<PartReference> AllReferences(const TrianglesView& triangles) {
  std::vector<PartReference> references;
  for (uint32_t i = 0; i < triangles.size(); ++i) references.push_back({i, triangles[i].GetBounds()});
  return references;
}

// Appends the subtree of `references`: by spatial splits at the box's middle while `spatial` is positive, then by
// object splits at the median.
inline void AppendBvh(const TrianglesView& triangles, std::vector<PartReference> references, size_t leaf_size,
                      int spatial, BvhArrays* bvh) {
  const size_t index = bvh->nodes.size();
  bvh->nodes.emplace_back();
  Bounds bounds;
  for (const PartReference& r : references) bounds.Extend(r.bounds);
  bvh->nodes[index].bounds = bounds;
  if (references.size() <= leaf_size) {
    bvh->nodes[index].offset = static_cast<uint32_t>(bvh->references.size());
    bvh->nodes[index].count = static_cast<uint32_t>(references.size());
    for (const PartReference& r : references) bvh->references.push_back(r.primitive);
    return;
  }
  const int axis = bounds.WidestAxis();
  std::vector<PartReference> left, right;
  if (spatial > 0) {
    const auto middle = static_cast<float>(bounds.DoubledCentre(axis) / 2);
    for (const PartReference& r : references) {
      Bounds l, g;
      SplitTriangle(triangles[r.primitive], axis, middle, r.bounds, &l, &g);
      if (!l.IsEmpty()) left.push_back({r.primitive, l});
      if (!g.IsEmpty() && r.bounds.max[axis] > middle) right.push_back({r.primitive, g});
    }
  }
  if (left.empty() || right.empty()) {
    std::sort(references.begin(), references.end(), [&](const PartReference& a, const PartReference& b) {
      return std::pair(a.bounds.DoubledCentre(axis), a.primitive) <
             std::pair(b.bounds.DoubledCentre(axis), b.primitive);
    });
    const auto middle = references.begin() + static_cast<std::ptrdiff_t>(references.size() / 2);
    left.assign(references.begin(), middle);
    right.assign(middle, references.end());
  }
  AppendBvh(triangles, left, leaf_size, spatial - 1, bvh);
  bvh->nodes[index].offset = static_cast<uint32_t>(bvh->nodes.size());
  AppendBvh(triangles, right, leaf_size, spatial - 1, bvh);
}

inline BvhArrays MakeBvh(const TrianglesView& triangles, size_t leaf_size, int spatial) {
  BvhArrays bvh;
  if (triangles.size() != 0) AppendBvh(triangles, AllReferences(triangles), leaf_size, spatial, &bvh);
  return bvh;
}

// Appends the cell of `references`, split at integer planes, which run through corners and flat triangles. A triangle
// that touches a cell only in the plane is not in that cell; one that lies in the plane is in the cell below.
inline void AppendKd(const TrianglesView& triangles, const std::vector<PartReference>& references, const Bounds& cell,
                     int depth, KdArrays* kd) {
  const size_t index = kd->nodes.size();
  kd->nodes.emplace_back();
  const int axis = cell.WidestAxis();
  const auto position = static_cast<float>(std::floor(cell.DoubledCentre(axis) / 2));
  if (depth == 0 || references.size() <= 2 || position <= cell.min[axis] || position >= cell.max[axis]) {
    kd->nodes[index].offset = static_cast<uint32_t>(kd->references.size());
    kd->nodes[index].count = static_cast<uint32_t>(references.size());
    for (const PartReference& r : references) kd->references.push_back(r.primitive);
    return;
  }
  std::vector<PartReference> below, above;
  Bounds below_cell = cell, above_cell = cell;
  below_cell.max[axis] = above_cell.min[axis] = position;
  for (const PartReference& r : references) {
    const Bounds b = ClipTriangle(triangles[r.primitive], below_cell);
    const Bounds a = ClipTriangle(triangles[r.primitive], above_cell);
    const bool is_above = a.max[axis] > position;
    if (is_above) above.push_back({r.primitive, a});
    if (b.min[axis] < position || !is_above) below.push_back({r.primitive, b});
  }
  kd->nodes[index].axis = static_cast<uint32_t>(axis);
  kd->nodes[index].position = position;
  AppendKd(triangles, below, below_cell, depth - 1, kd);
  kd->nodes[index].offset = static_cast<uint32_t>(kd->nodes.size());
  AppendKd(triangles, above, above_cell, depth - 1, kd);
}

inline KdArrays MakeKd(const TrianglesView& triangles, int depth) {
  KdArrays kd;
  if (triangles.size() == 0) return kd;
  const auto references = AllReferences(triangles);
  for (const PartReference& r : references) kd.bounds.Extend(r.bounds);
  AppendKd(triangles, references, kd.bounds, depth, &kd);
  return kd;
}

// All four kinds of query, with each culling and several caps, against brute force.
inline void ExpectSameAsBruteForce(const Tree& tree, const TrianglesView& triangles, std::span<const Ray> rays) {
  const BruteForce brute_force(triangles);
  const size_t n = rays.size();
  for (const Culling culling : {Culling::kNone, Culling::kBack, Culling::kFront}) {
    QueryOptions options{.culling = culling};
    std::vector<Hit> closest(n), expected_closest(n);
    tree.ClosestHits(rays, options, closest);
    brute_force.ClosestHits(rays, options, expected_closest);
    EXPECT_EQ(closest, expected_closest);

    std::vector<uint8_t> any(n), expected_any(n);
    tree.AnyHits(rays, options, any);
    brute_force.AnyHits(rays, options, expected_any);
    EXPECT_EQ(any, expected_any);

    std::vector<uint32_t> counts(n), expected_counts(n);
    tree.CountHits(rays, options, counts);
    brute_force.CountHits(rays, options, expected_counts);
    EXPECT_EQ(counts, expected_counts);

    for (const uint32_t cap : {1u, 3u, 1000u}) {
      options.max_hits_per_ray = cap;
      std::vector<Hit> all, expected_all;
      tree.AllHits(rays, options, &all, counts);
      brute_force.AllHits(rays, options, &expected_all, expected_counts);
      EXPECT_EQ(counts, expected_counts) << cap;
      EXPECT_EQ(all, expected_all) << cap;
    }
  }
}

}  // namespace deltaray

#endif  // TESTS_UNIT_TREE_SMALL_TREES_H_
