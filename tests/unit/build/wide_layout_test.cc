#include "server/build/wide_layout.h"

#include <tbb/task_arena.h>

#include <cmath>
#include <cstring>
#include <set>

#include "gtest/gtest.h"
#include "server/build/collapse.h"
#include "server/build/sweep_builder.h"
#include "server/tree/wide_tree.h"
#include "tests/scenes/random.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

struct Scene {
  std::vector<Vec3f> positions;
  std::vector<std::array<uint32_t, 3>> indices;
  TrianglesView view() const { return {positions, indices}; }
};

Scene RandomScene(uint32_t triangles, float scale, uint64_t seed) {
  Random random(seed);
  Scene scene;
  const auto coordinate = [&] { return scale * (static_cast<float>(random.Below(2001)) / 1000 - 1); };
  for (uint32_t i = 0; i < triangles; ++i) {
    for (int corner = 0; corner < 3; ++corner) scene.positions.push_back({coordinate(), coordinate(), coordinate()});
    scene.indices.push_back({3 * i, 3 * i + 1, 3 * i + 2});
  }
  return scene;
}

BvhArrays BinaryTree(const TrianglesView& triangles, BuildContext& context) {
  std::vector<Reference> references;
  for (uint32_t i = 0; i < triangles.size(); ++i) references.push_back({triangles[i].GetBounds(), i});
  return CollapsedTree(references, SplitBySweeps(references, SahCosts(Config()), context), SahCosts(Config()), 1)
      .ToBvhArrays();
}

template <typename T>
T Load(const WideArrays& arrays, uint32_t offset, size_t index) {
  T value;
  std::memcpy(&value, arrays.block.data() + offset * UnitBytes(Width(arrays.target)) + index * sizeof(T), sizeof(T));
  return value;
}

// Checks the subtree: children within their lanes' boxes, triangles as in the mesh, size classes. Returns its levels.
uint32_t Check(const WideArrays& arrays, const TrianglesView& triangles, uint32_t offset, std::set<uint32_t>* found,
               size_t* end) {
  const int width = Width(arrays.target);
  const size_t unit = UnitBytes(width);
  *end = std::max(*end, offset * unit + NodeBytes(width));
  uint32_t levels = 0;
  for (int lane = 0; lane < width; ++lane) {
    Bounds box;
    for (int axis = 0; axis < 3; ++axis) {
      box.min[axis] = Load<float>(arrays, offset, 2 * axis * width + lane);
      box.max[axis] = Load<float>(arrays, offset, (2 * axis + 1) * width + lane);
    }
    if (box.IsEmpty()) continue;
    const ChildRef child(Load<uint32_t>(arrays, offset, 6 * width + lane));
    if (!child.IsLeaf()) {
      levels = std::max(levels, Check(arrays, triangles, child.offset(), found, end));
      continue;
    }
    const uint32_t count = child.triangles();
    *end = std::max(*end, (child.offset() + LeafUnits(count, width)) * unit);
    for (uint32_t i = 0; i < count; ++i) {
      const auto id = Load<uint32_t>(arrays, child.offset(), kIdColumn * count + i);
      const uint32_t primitive = id & kPrimitiveMask;
      if (i > 0) {
        EXPECT_GT(primitive, Load<uint32_t>(arrays, child.offset(), kIdColumn * count + i - 1) & kPrimitiveMask);
      }
      found->insert(primitive);
      const Triangle triangle = triangles[primitive];
      Bounds bounds;
      for (int corner = 0; corner < 3; ++corner) {
        const Vec3f given = corner == 0 ? triangle.v0 : corner == 1 ? triangle.v1 : triangle.v2;
        Vec3f stored;
        for (int axis = 0; axis < 3; ++axis) {
          stored[axis] = Load<float>(arrays, child.offset(), (3 * corner + axis) * count + i);
          EXPECT_EQ(stored[axis], std::ldexp(given[axis], arrays.scale_exponent));
          EXPECT_LT(std::abs(stored[axis]), 1);
        }
        bounds.Extend(stored);
      }
      EXPECT_TRUE(box.Contains(bounds));
      double longest = 0;
      for (int axis = 0; axis < 3; ++axis) {
        longest = std::max(longest, static_cast<double>(bounds.max[axis]) - bounds.min[axis]);
      }
      const int size_class = static_cast<int>(id >> kPrimitiveBits);
      EXPECT_LE(longest, std::ldexp(1.0, 1 - size_class));
      if (size_class < kMaxSizeClass) {
        EXPECT_GT(longest, std::ldexp(1.0, -size_class));
      }
    }
  }
  return levels + 1;
}

TEST(WideLayoutTest, HoldsTheTree) {
  for (const SimdTarget target : {SimdTarget::kSse4, SimdTarget::kAvx2, SimdTarget::kAvx512}) {
    for (const uint32_t triangles : {1u, 8u, 9u, 500u}) {
      for (const float scale : {1.0f, 0.37f, 0x1p-90f, 0x1p100f}) {
        SCOPED_TRACE(testing::Message() << Name(target) << ", " << triangles << " triangles of size " << scale);
        const Scene scene = RandomScene(triangles, scale, 3);
        BuildContext context;
        const absl::StatusOr<WideArrays> arrays =
            LayOutWide(BinaryTree(scene.view(), context), scene.view(), target, context);
        ASSERT_TRUE(arrays.ok()) << arrays.status();
        EXPECT_TRUE(arrays->exact_corners);
        std::set<uint32_t> found;
        size_t end = 0;
        EXPECT_EQ(Check(*arrays, scene.view(), 0, &found, &end), arrays->levels);
        EXPECT_EQ(found.size(), triangles);
        // Nothing stands behind the tree but room to read.
        EXPECT_EQ(end + kLeafSlack, arrays->block.size());
      }
    }
  }
}

TEST(WideLayoutTest, BytesDoNotDependOnThreads) {
  const Scene scene = RandomScene(20'000, 1, 5);
  std::vector<WideArrays> made;
  for (const int threads : {1, 2, 4}) {
    tbb::task_arena arena(threads);
    arena.execute([&] {
      BuildContext context;
      absl::StatusOr<WideArrays> arrays =
          LayOutWide(BinaryTree(scene.view(), context), scene.view(), SimdTarget::kAvx2, context);
      ASSERT_TRUE(arrays.ok());
      made.push_back(*std::move(arrays));
    });
  }
  for (const WideArrays& arrays : made) {
    ASSERT_EQ(arrays.block.size(), made[0].block.size());
    EXPECT_EQ(std::memcmp(arrays.block.data(), made[0].block.data(), arrays.block.size()), 0);
  }
}

TEST(WideLayoutTest, CornersThatScalingRoundsAreTold) {
  Scene scene = RandomScene(20, 0x1p100f, 3);
  scene.positions[4].x = 0x1.8p-140f;
  BuildContext context;
  const absl::StatusOr<WideArrays> arrays =
      LayOutWide(BinaryTree(scene.view(), context), scene.view(), SimdTarget::kAvx2, context);
  ASSERT_TRUE(arrays.ok());
  EXPECT_FALSE(arrays->exact_corners);
}

TEST(WideLayoutTest, ALeafHasATriangleOnce) {
  const Scene scene = RandomScene(2, 1, 1);
  // A spatial split has put both on either side.
  BvhArrays tree;
  const Bounds all{{-1, -1, -1}, {1, 1, 1}};
  tree.nodes = {{all, 2, 0}, {all, 0, 2}, {all, 2, 2}};
  tree.references = {0, 1, 1, 0};
  BuildContext context;
  const absl::StatusOr<WideArrays> arrays = LayOutWide(tree, scene.view(), SimdTarget::kAvx2, context);
  ASSERT_TRUE(arrays.ok());
  EXPECT_EQ(ChildRef(Load<uint32_t>(*arrays, 0, 6 * 8)).triangles(), 2u);
}

TEST(WideLayoutTest, CancelEndsIt) {
  const Scene scene = RandomScene(1000, 1, 1);
  BuildContext context;
  const BvhArrays tree = BinaryTree(scene.view(), context);
  context.Cancel();
  EXPECT_TRUE(absl::IsCancelled(LayOutWide(tree, scene.view(), SimdTarget::kAvx2, context).status()));
}

}  // namespace
}  // namespace deltaray
