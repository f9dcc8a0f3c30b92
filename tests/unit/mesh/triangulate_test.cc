#include "server/mesh/triangulate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <functional>
#include <numbers>
#include <numeric>
#include <random>
#include <set>

namespace deltaray {
namespace {

using Polygon = std::vector<Vec3f>;

// Twice the signed area in x and y.
double DoubledArea(const Polygon& polygon, const std::vector<uint32_t>& corners) {
  double area = 0;
  const Vec3d o = static_cast<Vec3d>(polygon[corners[0]]);
  for (size_t i = 2; i < corners.size(); ++i) {
    const Vec3d a = static_cast<Vec3d>(polygon[corners[i - 1]]) - o, b = static_cast<Vec3d>(polygon[corners[i]]) - o;
    area += a.x * b.y - a.y * b.x;
  }
  return area;
}

struct Triangulated {
  bool simple = false;
  Triangulator::Triangles triangles;
};

Triangulated Triangulate(const Polygon& polygon) {
  std::vector<uint32_t> corners(polygon.size());
  std::iota(corners.begin(), corners.end(), 0);
  Triangulated result;
  result.triangles = {{7, 7, 7}};  // What was there before stays.
  result.simple = Triangulator(polygon).Append(corners, &result.triangles);
  EXPECT_EQ(result.triangles[0], (std::array<uint32_t, 3>{7, 7, 7}));
  result.triangles.erase(result.triangles.begin());
  EXPECT_EQ(result.triangles.size(), polygon.size() - 2);
  return result;
}

// Expects a triangulation of a simple polygon that lies in x and y: the triangles turn as the polygon does, their areas
// add up, every edge of the polygon is an edge of one triangle, every other edge of two. Returns how many have no area.
int ExpectGood(const Polygon& polygon) {
  const Triangulated result = Triangulate(polygon);
  EXPECT_TRUE(result.simple);
  std::vector<uint32_t> corners(polygon.size());
  std::iota(corners.begin(), corners.end(), 0);
  const double area = DoubledArea(polygon, corners);
  double sum = 0;
  int flat = 0;
  std::vector<std::pair<uint32_t, uint32_t>> edges;
  for (const auto& [a, b, c] : result.triangles) {
    const double part = DoubledArea(polygon, {a, b, c});
    EXPECT_GE(part * (area > 0 ? 1 : -1), 0) << a << " " << b << " " << c;
    flat += part == 0;
    sum += part;
    for (const auto& edge : {std::pair(a, b), std::pair(b, c), std::pair(c, a)}) edges.push_back(edge);
  }
  EXPECT_NEAR(sum, area, 1e-12 * std::abs(area) * polygon.size());
  std::sort(edges.begin(), edges.end());
  EXPECT_EQ(std::adjacent_find(edges.begin(), edges.end()), edges.end());
  for (const auto& [a, b] : edges) {
    const bool outline = b == (a + 1) % polygon.size();
    EXPECT_EQ(std::binary_search(edges.begin(), edges.end(), std::pair(b, a)), !outline) << a << " " << b;
  }
  return flat;
}

// Both ways round, and from the first few starts.
int ExpectGoodAllWays(Polygon polygon) {
  int flat = 0;
  for (size_t start = 0; start < std::min<size_t>(polygon.size(), 12); ++start) {
    flat = std::max(flat, ExpectGood(polygon));
    std::rotate(polygon.begin(), polygon.begin() + 1, polygon.end());
  }
  std::reverse(polygon.begin(), polygon.end());
  return std::max(flat, ExpectGood(polygon));
}

Polygon RegularPolygon(int n) {
  Polygon polygon;
  for (int i = 0; i < n; ++i) {
    const double angle = 2 * std::numbers::pi * i / n;
    polygon.push_back({static_cast<float>(std::cos(angle)), static_cast<float>(std::sin(angle)), 0});
  }
  return polygon;
}

// A thick letter C of n corners.
Polygon LetterC(int n) {
  Polygon polygon;
  for (int i = 0; i < n; ++i) {
    const bool inner = i >= n / 2;
    const double along = inner ? n - 1 - i : i, angle = 0.5 + along / (n / 2 - 1) * (2 * std::numbers::pi - 1);
    const double radius = inner ? 0.9 : 1.0;
    polygon.push_back({static_cast<float>(radius * std::cos(angle)), static_cast<float>(radius * std::sin(angle)), 0});
  }
  return polygon;
}

Polygon Comb(int teeth) {
  Polygon polygon = {{2.0f * teeth, -1, 0}};
  for (int i = teeth - 1; i >= 0; --i) {
    polygon.push_back({2.0f * i + 1, 1000, 0});
    polygon.push_back({2.0f * i, 0, 0});
  }
  polygon.push_back({0, -1, 0});
  return polygon;
}

Polygon Spiral(int n) {
  Polygon polygon;
  const auto point = [&](double along, double offset) {
    const double angle = 0.3 * along, radius = 5 + along + offset;
    polygon.push_back({static_cast<float>(radius * std::cos(angle)), static_cast<float>(radius * std::sin(angle)), 0});
  };
  for (int i = 0; i < n / 2; ++i) point(i, 0);
  for (int i = n / 2 - 1; i >= 0; --i) point(i, 4);
  return polygon;
}

// Simple, since it has one corner in each direction from the origin.
Polygon RandomStar(int n, std::mt19937* random) {
  Polygon polygon;
  std::uniform_real_distribution<double> radius(0.01, 1);
  for (int i = 0; i < n; ++i) {
    const double angle = 2 * std::numbers::pi * i / n, r = radius(*random);
    polygon.push_back({static_cast<float>(r * std::cos(angle)), static_cast<float>(r * std::sin(angle)), 0});
  }
  return polygon;
}

// The outline of a random tree of the cells of a grid: simple, with many corners on a line.
Polygon RandomGridPolygon(int cells, std::mt19937* random) {
  using Cell = std::pair<int, int>;
  static constexpr Cell kSteps[] = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}};
  std::set<Cell> inside = {{0, 0}};
  std::vector<Cell> list = {{0, 0}};
  while (static_cast<int>(list.size()) < cells) {
    const Cell parent = list[(*random)() % list.size()], step = kSteps[(*random)() % 4];
    const Cell cell = {parent.first + step.first, parent.second + step.second};
    // It may touch no cell but its parent and, at a corner, those next to the parent: then the outline has no hole and
    // touches itself nowhere.
    bool fits = inside.count(cell) == 0;
    for (int i = cell.first - 1; i <= cell.first + 1; ++i) {
      for (int j = cell.second - 1; j <= cell.second + 1; ++j) {
        if (std::abs(i - parent.first) + std::abs(j - parent.second) > 1) fits = fits && inside.count({i, j}) == 0;
      }
    }
    if (!fits) continue;
    inside.insert(cell);
    list.push_back(cell);
  }
  // Walk along the border with the inside on the left.
  Polygon polygon;
  int x = 0, y = 0, direction = 0;
  while (inside.count({x, y - 1}) > 0) --y;
  const int start_x = x, start_y = y;
  const auto is_inside = [&](int right) {
    // The cell ahead, on the left or the right of the walk.
    const int dx = kSteps[direction].first, dy = kSteps[direction].second;
    const int side_x = right ? dy : -dy, side_y = right ? -dx : dx;
    return inside.count({x + (dx + side_x - 1) / 2, y + (dy + side_y - 1) / 2}) > 0;
  };
  do {
    polygon.push_back({static_cast<float>(x), static_cast<float>(y), 0});
    x += kSteps[direction].first;
    y += kSteps[direction].second;
    if (is_inside(1)) {
      direction = (direction + 3) % 4;
    } else if (!is_inside(0)) {
      direction = (direction + 1) % 4;
    }
  } while (x != start_x || y != start_y || direction != 0);
  return polygon;
}

TEST(TriangulateTest, TriangleStaysAsItIs) {
  const Triangulated result = Triangulate({{0, 0, 0}, {0, 1, 0}, {1, 0, 0}});
  EXPECT_TRUE(result.simple);
  EXPECT_THAT(result.triangles, testing::ElementsAre(std::array<uint32_t, 3>{0, 1, 2}));
}

TEST(TriangulateTest, ConvexPolygons) {
  for (int n = 4; n < 40; ++n) EXPECT_EQ(ExpectGoodAllWays(RegularPolygon(n)), 0) << n;
  ExpectGood(RegularPolygon(1000));
}

TEST(TriangulateTest, ConcaveQuadIsSplitAtItsInnerCorner) {
  EXPECT_EQ(ExpectGoodAllWays({{0, 0, 0}, {2, 0, 0}, {0.5f, 0.5f, 0}, {0, 2, 0}}), 0);
}

TEST(TriangulateTest, QuadWithACornerOnALineHasNoFlatTriangle) {
  EXPECT_EQ(ExpectGoodAllWays({{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {0, 2, 0}}), 0);
}

// tinyobjloader's triangles of such a polygon have six times its area.
TEST(TriangulateTest, LetterCOfFiftyCorners) { EXPECT_EQ(ExpectGoodAllWays(LetterC(50)), 0); }

TEST(TriangulateTest, Combs) {
  for (const int teeth : {1, 2, 3, 10, 500}) EXPECT_EQ(ExpectGoodAllWays(Comb(teeth)), 0) << teeth;
}

TEST(TriangulateTest, Spirals) {
  for (const int n : {8, 20, 100, 1000}) EXPECT_EQ(ExpectGoodAllWays(Spiral(n)), 0) << n;
}

TEST(TriangulateTest, RandomStars) {
  std::mt19937 random(1);
  for (int round = 0; round < 300; ++round)
    EXPECT_EQ(ExpectGoodAllWays(RandomStar(4 + round % 60, &random)), 0) << round;
  ExpectGood(RandomStar(5000, &random));
}

TEST(TriangulateTest, RandomGridPolygonsWithManyCornersOnALine) {
  std::mt19937 random(2);
  for (int round = 0; round < 200; ++round) {
    EXPECT_EQ(ExpectGood(RandomGridPolygon(1 + round % 50, &random)), 0) << round;
  }
}

TEST(TriangulateTest, RepeatedCornersCostOneFlatTriangleEach) {
  Polygon polygon = {{0, 0, 0}, {0, 0, 0}, {4, 0, 0}, {4, 4, 0}, {2, 1, 0}, {2, 1, 0}, {2, 1, 0}, {0, 4, 0}};
  EXPECT_EQ(ExpectGoodAllWays(polygon), 3);
}

TEST(TriangulateTest, HoleJoinedToTheOutlineByADoubleEdge) {
  // A square with a square hole, and the same with two holes at one corner of the outline.
  EXPECT_EQ(ExpectGoodAllWays({{0, 0, 0},
                               {9, 0, 0},
                               {9, 9, 0},
                               {0, 9, 0},
                               {0, 0, 0},
                               {3, 3, 0},
                               {3, 6, 0},
                               {6, 6, 0},
                               {6, 3, 0},
                               {3, 3, 0}}),
            0);
  ExpectGoodAllWays({{0, 0, 0},
                     {9, 0, 0},
                     {9, 9, 0},
                     {0, 9, 0},
                     {0, 0, 0},
                     {1, 4, 0},
                     {1, 6, 0},
                     {2, 6, 0},
                     {2, 4, 0},
                     {1, 4, 0},
                     {0, 0, 0},
                     {4, 1, 0},
                     {4, 2, 0},
                     {6, 2, 0},
                     {6, 1, 0},
                     {4, 1, 0}});
}

TEST(TriangulateTest, ExactWhereDoubleIsNot) {
  // A long sliver far from zero: its corners are one unit in the last place apart.
  const float x = 16777216;
  ExpectGoodAllWays({{x, x, 0}, {-x, -x, 0}, {-x, -x + 2, 0}, {0, 1, 0}, {x - 1, x, 0}});
  const float tiny = 1e-45f;
  ExpectGoodAllWays({{0, 0, 0}, {3 * tiny, 0, 0}, {tiny, tiny, 0}, {0, 3 * tiny, 0}});
  const float huge = 3e38f;
  ExpectGoodAllWays({{-huge, -huge, 0}, {huge, -huge, 0}, {-huge / 2, -huge / 2, 0}, {-huge, huge, 0}});
}

TEST(TriangulateTest, AnyPlaneOfSpace) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  for (int round = 0; round < 200; ++round) {
    const Polygon flat = RandomStar(5 + round % 30, &random);
    const Vec3d u{normal(random), normal(random), normal(random)}, v{normal(random), normal(random), normal(random)};
    Polygon polygon;
    for (const Vec3f& p : flat) polygon.push_back(static_cast<Vec3f>(double{p.x} * u + double{p.y} * v));
    const Triangulated result = Triangulate(polygon);
    EXPECT_TRUE(result.simple);
    Vec3d sum, total;
    double areas = 0;
    for (const auto& [a, b, c] : result.triangles) {
      const Vec3d o = static_cast<Vec3d>(polygon[a]);
      const Vec3d cross = Cross(static_cast<Vec3d>(polygon[b]) - o, static_cast<Vec3d>(polygon[c]) - o);
      areas += Length(cross);
      sum = sum + cross;
    }
    for (size_t i = 2; i < polygon.size(); ++i) {
      const Vec3d o = static_cast<Vec3d>(polygon[0]);
      total = total + Cross(static_cast<Vec3d>(polygon[i - 1]) - o, static_cast<Vec3d>(polygon[i]) - o);
    }
    EXPECT_NEAR(areas, Length(total), 1e-5 * areas);
    EXPECT_GT(Dot(sum, total), 0);
  }
}

TEST(TriangulateTest, WhatIsNotSimpleBecomesAFan) {
  const auto expect_fan = [](const Polygon& polygon) {
    const Triangulated result = Triangulate(polygon);
    EXPECT_FALSE(result.simple);
    for (uint32_t i = 0; i + 2 < polygon.size(); ++i) {
      EXPECT_EQ(result.triangles[i], (std::array<uint32_t, 3>{0, i + 1, i + 2}));
    }
  };
  expect_fan({{0, 0, 0}, {1, 1, 0}, {1, 0, 0}, {0, 1, 0}});             // a bow tie
  expect_fan({{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {3, 0, 0}});             // on a line
  expect_fan({{1, 2, 3}, {1, 2, 3}, {1, 2, 3}, {1, 2, 3}, {1, 2, 3}});  // a point
  Polygon pentagram;
  for (int i = 0; i < 5; ++i) pentagram.push_back(RegularPolygon(5)[2 * i % 5]);
  expect_fan(pentagram);
  Polygon twice = RegularPolygon(6);
  for (const Vec3f& p : RegularPolygon(6)) twice.push_back(0.5f * p);
  expect_fan(twice);
}

TEST(TriangulateTest, RandomCornersNeverFail) {
  std::mt19937 random(4);
  for (int round = 0; round < 20000; ++round) {
    Polygon polygon(3 + random() % 12);
    for (Vec3f& p : polygon) {
      p = {static_cast<float>(random() % 4), static_cast<float>(random() % 4), static_cast<float>(random() % 4)};
    }
    Triangulate(polygon);
  }
}

// Rows of teeth along one long edge: the ears between the two are as long as the polygon, and many points are near
// them.
Polygon Sawtooth(int n, double bend) {
  Polygon polygon;
  const double size = n;
  const auto point = [&](double along, double away) {
    const double x = along, y = along + bend * along * (size - along) / size + away;
    polygon.push_back({static_cast<float>(x), static_cast<float>(y), 0});
  };
  polygon.push_back({0, 0, 0});
  polygon.push_back({static_cast<float>(size), static_cast<float>(size), 0});
  for (int i = n / 2 - 1; i > 0; --i) {
    point(2 * i + 0.2, 0.4);
    point(2 * i, 9);
  }
  return polygon;
}

// Eight times as many corners take eight times as long and a bit; testing every corner for every ear would take 64
// times.
TEST(TriangulateTest, TimeGrowsHardlyFasterThanCorners) {
  const auto seconds = [](const Polygon& polygon) {
    const std::clock_t start = std::clock();
    EXPECT_TRUE(Triangulate(polygon).simple);
    return static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
  };
  const std::pair<const char*, std::function<Polygon(int)>> shapes[] = {
      {"comb", [](int n) { return Comb(n / 2); }},
      {"spiral", Spiral},
      {"C", LetterC},
      {"star",
       [](int n) {
         std::mt19937 random(5);
         return RandomStar(n, &random);
       }},
      {"sawtooth", [](int n) { return Sawtooth(n, 0); }},
      {"bent sawtooth", [](int n) { return Sawtooth(n, 0.2); }},
      {"slightly bent sawtooth", [](int n) { return Sawtooth(n, 0.0001); }}};
  for (const auto& [name, make] : shapes) {
    const double few = seconds(make(8000)), many = seconds(make(64000));
    EXPECT_LT(many, 40 * few + 0.1) << name;
  }
}

}  // namespace
}  // namespace deltaray
