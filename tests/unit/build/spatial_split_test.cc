#include "server/build/spatial_split.h"

#include <algorithm>
#include <map>

#include "gtest/gtest.h"
#include "tests/scenes/made.h"
#include "tests/scenes/pathological.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

// A mesh's references, and twice as much room as they take.
struct Node {
  TriangleMesh mesh;
  std::vector<Reference> references;
  size_t count;
  Bounds bounds;

  explicit Node(TriangleMesh made) : mesh(std::move(made)) {
    for (uint32_t i = 0; i < mesh.indices.size(); ++i) references.push_back({mesh.triangles()[i].GetBounds(), i});
    count = references.size();
    bounds = UnionOf(references);
    references.resize(2 * count);
  }
  std::span<const Reference> used() const { return std::span(references).first(count); }
  SpatialSplit Find(size_t room) const {
    BuildContext context;
    return FindSpatialSplit(used(), mesh.triangles(), bounds, SahCosts(Config()), room, context);
  }
};

TriangleMesh Copies(uint32_t count) {
  TriangleMesh mesh;
  for (uint32_t i = 0; i < count; ++i) AddTriangle(&mesh, {0, 0, 0}, {1, 0, 0.5}, {0, 1, 1});
  return mesh;
}

TEST(SpatialSplitTest, PartsTwoLongTrianglesThatCross) {
  // An X of two thin slivers: objects cannot be told apart, space can.
  TriangleMesh mesh;
  AddTriangle(&mesh, {0, 0, 0}, {10, 10, 0}, {10, 10, 0.1});
  AddTriangle(&mesh, {0, 10, 0}, {10, 0, 0}, {10, 0, 0.1});
  AddTriangle(&mesh, {0, 0, 0}, {0.1, 0, 0}, {0, 0.1, 0});
  AddTriangle(&mesh, {10, 10, 0}, {9.9, 10, 0}, {10, 9.9, 0});
  Node node(mesh);
  const SpatialSplit split = node.Find(node.count);
  ASSERT_TRUE(split.IsFound());
  BuildContext context;
  const auto [left, right] = Partition(node.references, node.count, node.mesh.triangles(), split, context);
  EXPECT_EQ(left + right, 6u);
  const std::span<const Reference> all(node.references);
  EXPECT_LT(Intersection(UnionOf(all.first(left)), UnionOf(all.subspan(left, right))).HalfArea(),
            0.1 * node.bounds.HalfArea());
}

TEST(SpatialSplitTest, NothingOfATriangleIsLost) {
  for (uint64_t seed = 1; seed < 20; ++seed) {
    Node node(Soup(500, seed));
    const SpatialSplit split = node.Find(node.count);
    ASSERT_TRUE(split.IsFound());
    BuildContext context;
    const auto [left, right] = Partition(node.references, node.count, node.mesh.triangles(), split, context);
    const size_t all = left + right;
    // Both sides are smaller than the whole.
    EXPECT_LT(left, node.count);
    EXPECT_LT(right, node.count);
    EXPECT_GT(left, 0u);
    EXPECT_GT(right, 0u);
    ASSERT_GE(all, node.count);

    std::map<uint32_t, std::vector<Bounds>> parts_of;
    for (size_t i = 0; i < all; ++i) {
      parts_of[node.references[i].primitive].push_back(node.references[i].bounds);
    }
    EXPECT_EQ(parts_of.size(), node.count);
    Random random(seed);
    for (const auto& [primitive, boxes] : parts_of) {
      const Triangle t = node.mesh.triangles()[primitive];
      EXPECT_LE(boxes.size(), 2u);
      for (int i = 0; i < 20; ++i) {
        const float u = static_cast<float>(random.Uniform()), v = static_cast<float>(random.Uniform(0, 1 - u));
        const Vec3f point = t.v0 + u * (t.v1 - t.v0) + v * (t.v2 - t.v0);
        EXPECT_TRUE(std::any_of(boxes.begin(), boxes.end(), [&](Bounds box) {
          for (int axis = 0; axis < 3; ++axis) {
            // The point is rounded.
            box.min[axis] -= 1e-6f;
            box.max[axis] += 1e-6f;
          }
          return Covers(box, point);
        })) << primitive;
      }
    }
  }
}

TEST(SpatialSplitTest, StaysWithinTheRoom) {
  Node node(Soup(500, 5));
  BuildContext context;
  for (const size_t room : {0, 1, 5, 50}) {
    const SpatialSplit split = node.Find(room);
    if (!split.IsFound()) continue;
    std::vector<Reference> references(node.used().begin(), node.used().end());
    references.resize(node.count + room);
    const auto [left, right] = Partition(references, node.count, node.mesh.triangles(), split, context);
    EXPECT_LE(left + right, node.count + room);
  }
}

// As where a task that threw has left others with sums of a part.
TEST(SpatialSplitTest, NothingIsWrittenPastTheRoomHoweverTheSplitCameAbout) {
  for (const size_t room : {0, 1, 5}) {
    Node node(Soup(500, 5));
    const SpatialSplit split = node.Find(node.count);
    ASSERT_TRUE(split.IsFound());
    BuildContext context;
    const auto [left, right] = Partition(std::span(node.references).first(node.count + room), node.count,
                                         node.mesh.triangles(), split, context);
    EXPECT_EQ(left + right, node.count + room);  // more would be cut
    EXPECT_GT(left, 0u);
    EXPECT_GT(right, 0u);
    for (size_t i = node.count + room; i < node.references.size(); ++i)
      EXPECT_TRUE(node.references[i].bounds.IsEmpty());
  }
}

TEST(SpatialSplitTest, CopiesDoNotSplit) { EXPECT_FALSE(Node(Copies(100)).Find(100).IsFound()); }

TEST(SpatialSplitTest, FlatTrianglesInThePlaneGoToOneSide) {
  // A floor between two walls of small triangles.
  TriangleMesh mesh;
  AddParallelogram(&mesh, {0, 0, 8}, {16, 0, 0}, {0, 16, 0});
  for (int z = 0; z <= 15; z += 5) {
    AddTriangle(&mesh, {0, 0, z + 0.25}, {1, 0, z + 0.5}, {0, 1, z + 0.75});
  }
  AddTriangle(&mesh, {0, 0, 0}, {1, 0, 0}, {0, 1, 0});
  AddTriangle(&mesh, {0, 0, 16}, {1, 0, 16}, {0, 1, 16});
  Node node(mesh);
  BuildContext context;
  const SpatialSplit split{1, PointBins(PackedBounds(node.bounds), 16), 2, 8, 8.0f};
  const auto [left, right] = Partition(node.references, node.count, node.mesh.triangles(), split, context);
  EXPECT_EQ(left + right, node.count);
}

}  // namespace
}  // namespace deltaray
