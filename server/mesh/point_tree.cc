#include "server/mesh/point_tree.h"

#include <algorithm>
#include <cmath>

namespace deltaray {
namespace {

constexpr uint32_t kLeafSize = 8;
// Halving 2^31 points down to leaves ends well before this depth.
constexpr int kMaxDepth = 40;

}  // namespace

bool PointTree::Box::IsRightOf(Point2 a, Point2 b) const {
  // How far the box reaches to the left of the line, times the length of ab.
  const double nx = double{a.y} - b.y, ny = double{b.x} - a.x;
  const double reach = nx * (centre.x - a.x) + ny * (centre.y - a.y) + std::abs(nx * along.x + ny * along.y) +
                       std::abs(nx * across.x + ny * across.y);
  // Far more than all roundings here and in Enclose, and far less than float32 can tell apart.
  constexpr double kRounding = 1e-13;
  const double size = std::abs(centre.x) + std::abs(centre.y) + std::abs(a.x) + std::abs(a.y) + std::abs(along.x) +
                      std::abs(along.y) + std::abs(across.x) + std::abs(across.y);
  return reach < -kRounding * (std::abs(nx) + std::abs(ny)) * size;
}

PointTree::Box PointTree::Enclose(std::span<const uint32_t> ids, Point2 p, Point2 q) const {
  const double dx = double{q.x} - p.x, dy = double{q.y} - p.y, square = dx * dx + dy * dy;
  if (square == 0) return {{p.x, p.y}, {}, {}};
  double least_s = 0, most_s = 0, least_t = 0, most_t = 0;
  for (const uint32_t id : ids) {
    const double x = double{points_[id].x} - p.x, y = double{points_[id].y} - p.y;
    const double s = (x * dx + y * dy) / square, t = (y * dx - x * dy) / square;
    least_s = std::min(least_s, s);
    most_s = std::max(most_s, s);
    least_t = std::min(least_t, t);
    most_t = std::max(most_t, t);
  }
  const double s = (least_s + most_s) / 2, t = (least_t + most_t) / 2;
  const double half_s = (most_s - least_s) / 2, half_t = (most_t - least_t) / 2;
  return {{p.x + s * dx - t * dy, p.y + s * dy + t * dx}, {half_s * dx, half_s * dy}, {-half_t * dy, half_t * dx}};
}

void PointTree::Build(std::span<const Point2> points, std::span<const uint32_t> ids) {
  points_ = points;
  ids_.assign(ids.begin(), ids.end());
  place_.assign(points.size(), kNowhere);
  leaf_.resize(points.size());
  nodes_.clear();
  if (!ids.empty()) BuildNode(0, ids.size(), 0);
}

uint32_t PointTree::BuildNode(uint32_t begin, uint32_t end, uint32_t parent) {
  const uint32_t index = nodes_.size();
  const auto part = std::span(ids_).subspan(begin, end - begin);
  const auto by_x = [this](uint32_t a, uint32_t b) { return points_[a].x < points_[b].x; };
  const auto by_y = [this](uint32_t a, uint32_t b) { return points_[a].y < points_[b].y; };
  const auto [left, right] = std::minmax_element(part.begin(), part.end(), by_x);
  const auto [low, high] = std::minmax_element(part.begin(), part.end(), by_y);
  const Point2 min{points_[*left].x, points_[*low].y}, max{points_[*right].x, points_[*high].y};
  const bool is_wide = double{max.x} - min.x >= double{max.y} - min.y;
  const Box box =
      is_wide ? Enclose(part, points_[*left], points_[*right]) : Enclose(part, points_[*low], points_[*high]);
  nodes_.push_back({min, max, box, begin, end, end - begin, parent, 0});
  if (end - begin <= kLeafSize) {
    for (uint32_t i = begin; i < end; ++i) {
      place_[ids_[i]] = i;
      leaf_[ids_[i]] = index;
    }
    return index;
  }
  const uint32_t middle = begin + (end - begin) / 2;
  if (is_wide) {
    std::nth_element(ids_.begin() + begin, ids_.begin() + middle, ids_.begin() + end, by_x);
  } else {
    std::nth_element(ids_.begin() + begin, ids_.begin() + middle, ids_.begin() + end, by_y);
  }
  BuildNode(begin, middle, index);
  const uint32_t second = BuildNode(middle, end, index);
  nodes_[index].second = second;
  return index;
}

void PointTree::Remove(uint32_t id) {
  Node& leaf = nodes_[leaf_[id]];
  const uint32_t place = place_[id], last = ids_[--leaf.end];
  ids_[place] = last;
  place_[last] = place;
  place_[id] = kNowhere;
  for (uint32_t node = leaf_[id];; node = nodes_[node].parent) {
    --nodes_[node].count;
    if (node == 0) return;
  }
}

bool PointTree::AnyIn(Point2 a, Point2 b, Point2 c, bool closed) const {
  if (nodes_.empty()) return false;
  const Point2 min{std::min({a.x, b.x, c.x}), std::min({a.y, b.y, c.y})};
  const Point2 max{std::max({a.x, b.x, c.x}), std::max({a.y, b.y, c.y})};
  const int least = closed ? 0 : 1;
  const auto is_inside = [&](Point2 p) {
    return p != a && p != b && p != c && Orientation(a, b, p) >= least && Orientation(b, c, p) >= least &&
           Orientation(c, a, p) >= least;
  };
  uint32_t stack[kMaxDepth];
  int size = 0;
  stack[size++] = 0;
  while (size > 0) {
    const uint32_t index = stack[--size];
    const Node& node = nodes_[index];
    if (node.count == 0 || node.max.x < min.x || node.min.x > max.x || node.max.y < min.y || node.min.y > max.y ||
        node.box.IsRightOf(a, b) || node.box.IsRightOf(b, c) || node.box.IsRightOf(c, a)) {
      continue;
    }
    if (node.second != 0) {
      stack[size++] = node.second;
      stack[size++] = index + 1;
      continue;
    }
    for (uint32_t i = node.begin; i < node.end; ++i) {
      if (is_inside(points_[ids_[i]])) return true;
    }
  }
  return false;
}

}  // namespace deltaray
