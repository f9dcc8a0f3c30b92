#include "server/build/morton_order.h"

#include <tbb/task_arena.h>

#include <numeric>

#include "gtest/gtest.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

// Boxes without width at the corners of a grid of size³ cubes, of which each is a power of two of those of the curve.
std::vector<Reference> Grid(uint32_t size) {
  std::vector<Reference> references;
  for (uint32_t i = 0; i < size * size * size; ++i) {
    const Vec3f point{static_cast<float>(i % size), static_cast<float>(i / size % size),
                      static_cast<float>(i / size / size)};
    references.push_back({{point, point}, i});
  }
  return references;
}

// The place of a point on the curve, bit by bit.
uint32_t PlaceOf(Vec3f point) {
  uint32_t place = 0;
  for (int bit = 0; bit < 8; ++bit) {
    for (int axis = 0; axis < 3; ++axis) {
      place |= (static_cast<uint32_t>(point[axis]) >> bit & 1) << (3 * bit + axis);
    }
  }
  return place;
}

TEST(MortonOrderTest, GridsAreInTheOrderOfTheCurve) {
  // The last cubes hold both of the last points: those are moved apart.
  const std::vector<Reference> grid = Grid(16);
  std::vector<Reference> references = grid;
  references.push_back({{{16, 16, 16}, {16, 16, 16}}, 0});
  BuildContext context;
  const std::vector<uint32_t> order = MortonOrder(references, context);
  ASSERT_EQ(order.size(), references.size());
  EXPECT_EQ(order.back(), grid.size());
  for (uint32_t i = 0; i < grid.size(); ++i) EXPECT_EQ(PlaceOf(grid[order[i]].bounds.min), i);
}

TEST(MortonOrderTest, EachReferenceIsThereOnceForAnyNumberOfThreads) {
  for (const uint32_t count : {0, 1, 2, 1000, 200'000}) {
    const std::vector<Reference> references = RandomReferences(count, count);
    BuildContext context;
    const std::vector<uint32_t> order = MortonOrder(references, context);
    std::vector<uint32_t> sorted = order, all(count);
    std::sort(sorted.begin(), sorted.end());
    std::iota(all.begin(), all.end(), 0);
    EXPECT_EQ(sorted, all);
    tbb::task_arena(1).execute([&] { EXPECT_EQ(MortonOrder(references, context), order); });
    EXPECT_EQ(context.peak_bytes(), 16 * count);
  }
}

TEST(MortonOrderTest, CopiesStayInTheOrderGiven) {
  const std::vector<Reference> copies(1000, RandomReferences(1, 1)[0]);
  BuildContext context;
  const std::vector<uint32_t> order = MortonOrder(copies, context);
  EXPECT_TRUE(std::is_sorted(order.begin(), order.end()));
}

TEST(MortonOrderTest, EndsEarlyOnceCancelled) {
  BuildContext context;
  context.Cancel();
  EXPECT_TRUE(MortonOrder(RandomReferences(100'000, 1), context).empty());
}

}  // namespace
}  // namespace deltaray
