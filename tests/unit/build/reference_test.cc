#include "server/build/reference.h"

#include <utility>

#include "gtest/gtest.h"
#include "tests/scenes/pathological.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

TEST(ReferenceTest, DegenerateTrianglesHaveNone) {
  TriangleMesh mesh;
  mesh.positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {2, 0, 0}};
  mesh.indices = {{0, 1, 3}, {0, 1, 2}, {1, 1, 2}, {1, 2, 3}};
  BuildContext context;
  const absl::StatusOr<ReferenceArray> references = MakeReferences(mesh.triangles(), 0, context);
  ASSERT_TRUE(references.ok());
  ASSERT_EQ(references->size(), 2u);
  EXPECT_EQ(references->span()[0].primitive, 1u);
  EXPECT_EQ(references->span()[0].bounds, mesh.triangles()[1].GetBounds());
  EXPECT_EQ(references->span()[1].primitive, 3u);
  EXPECT_EQ(context.triangles, 2u);
}

TEST(ReferenceTest, HasTheRoomThatTheBudgetGives) {
  TriangleMesh mesh;
  AddSphere(&mesh, {0, 0, 0}, 1, 40);
  BuildContext context;
  const absl::StatusOr<ReferenceArray> references = MakeReferences(mesh.triangles(), 0.5, context);
  ASSERT_TRUE(references.ok());
  EXPECT_EQ(references->capacity(), mesh.indices.size() * 3 / 2);
  for (uint32_t i = 0; i < references->size(); ++i) ASSERT_EQ(references->span()[i].primitive, i);
}

TEST(ReferenceTest, CancelledBuildsGetNone) {
  TriangleMesh mesh;
  AddSphere(&mesh, {0, 0, 0}, 1, 10);
  BuildContext context;
  context.Cancel();
  EXPECT_EQ(MakeReferences(mesh.triangles(), 1, context).status().code(), absl::StatusCode::kCancelled);
}

TEST(ReferenceTest, ArraysCountTheirBytesWhereverTheyGo) {
  BuildContext context;
  {
    ReferenceArray array(100, context);
    array.set_size(10);
    array.data()[9] = {{}, 9};
    ReferenceArray other = std::move(array);
    other.ShrinkToFit();
    EXPECT_EQ(other.capacity(), 10u);
    EXPECT_EQ(other.span()[9].primitive, 9u);
    EXPECT_EQ(context.peak_bytes(), 100 * sizeof(Reference));
    context.CountBytes(static_cast<int64_t>(95 * sizeof(Reference)));
    EXPECT_EQ(context.peak_bytes(), 105 * sizeof(Reference));
    context.CountBytes(-static_cast<int64_t>(95 * sizeof(Reference)));
  }
  // All given back: only more than the peak raises it.
  context.CountBytes(105 * sizeof(Reference));
  EXPECT_EQ(context.peak_bytes(), 105 * sizeof(Reference));
}

}  // namespace
}  // namespace deltaray
