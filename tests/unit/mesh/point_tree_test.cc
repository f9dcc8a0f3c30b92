#include "server/mesh/point_tree.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace deltaray {
namespace {

bool BruteForce(const std::vector<Point2>& points, const std::vector<bool>& present, Point2 a, Point2 b, Point2 c,
                bool closed) {
  const int least = closed ? 0 : 1;
  for (size_t i = 0; i < points.size(); ++i) {
    const Point2 p = points[i];
    if (present[i] && p != a && p != b && p != c && Orientation(a, b, p) >= least && Orientation(b, c, p) >= least &&
        Orientation(c, a, p) >= least) {
      return true;
    }
  }
  return false;
}

// Compares with brute force while the points are removed one after the other.
void Compare(const std::vector<Point2>& points, std::mt19937* random) {
  std::vector<uint32_t> ids;
  std::vector<bool> present(points.size());
  for (uint32_t i = 0; i < points.size(); ++i) {
    present[i] = i % 3 != 0;
    if (present[i]) ids.push_back(i);
  }
  PointTree tree;
  tree.Build(points, ids);
  int hits = 0, queries = 0;
  std::shuffle(ids.begin(), ids.end(), *random);
  for (const uint32_t id : ids) {
    for (int i = 0; i < 8; ++i) {
      const Point2 a = points[(*random)() % points.size()], b = points[(*random)() % points.size()];
      const Point2 c = i % 2 ? points[(*random)() % points.size()] : Point2{(a.x + b.x) / 2, (a.y + b.y) / 2};
      if (Orientation(a, b, c) <= 0) continue;
      for (const bool closed : {false, true}) {
        const bool expected = BruteForce(points, present, a, b, c, closed);
        ASSERT_EQ(tree.AnyIn(a, b, c, closed), expected);
        hits += expected;
        ++queries;
      }
    }
    ASSERT_TRUE(tree.Contains(id));
    tree.Remove(id);
    ASSERT_FALSE(tree.Contains(id));
    present[id] = false;
  }
  EXPECT_GT(hits, 0);
  EXPECT_LT(hits, queries);
}

TEST(PointTreeTest, AgreesWithBruteForce) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> unit(-1, 1);
  std::vector<Point2> square(600), line(600), grid(600), wide(600);
  for (int i = 0; i < 600; ++i) {
    square[i] = {unit(random), unit(random)};
    line[i] = {i * 0.37f, i * 0.11f + 1e-4f * unit(random)};
    grid[i] = {static_cast<float>(random() % 12), static_cast<float>(random() % 12)};
    wide[i] = {std::ldexp(unit(random), static_cast<int>(random() % 250) - 125),
               std::ldexp(unit(random), static_cast<int>(random() % 250) - 125)};
  }
  for (const auto& points : {square, line, grid, wide}) Compare(points, &random);
}

TEST(PointTreeTest, HoldsNothingAtFirst) {
  const std::vector<Point2> points = {{0, 0}, {1, 0}, {0, 1}, {0.2f, 0.2f}};
  PointTree tree;
  tree.Build(points, {});
  EXPECT_FALSE(tree.AnyIn(points[0], points[1], points[2], true));
  const std::vector<uint32_t> ids = {3};
  tree.Build(points, ids);
  EXPECT_TRUE(tree.AnyIn(points[0], points[1], points[2], true));
  tree.Build(points, {});
  EXPECT_FALSE(tree.Contains(3));
}

}  // namespace
}  // namespace deltaray
