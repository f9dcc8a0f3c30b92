// Which points of a set lie in a triangle.

#ifndef SERVER_MESH_POINT_TREE_H_
#define SERVER_MESH_POINT_TREE_H_

#include <cstdint>
#include <span>
#include <vector>

#include "server/mesh/orientation.h"

namespace deltaray {

// A kd-tree over points of the plane, from which points can be removed. Keeps its memory from one Build to the next.
class PointTree {
 public:
  // Holds the points points[id] for each of `ids`. `points` must outlive the queries.
  void Build(std::span<const Point2> points, std::span<const uint32_t> ids);

  bool Contains(uint32_t id) const { return place_[id] != kNowhere; }

  // REQUIRES: Contains(id).
  void Remove(uint32_t id);

  // Whether any point lies in the triangle a, b, c, whose corners turn to the left: with its border where `closed`,
  // without it where not. Points at the corners do not count.
  bool AnyIn(Point2 a, Point2 b, Point2 c, bool closed) const;

 private:
  static constexpr uint32_t kNowhere = 0xFFFFFFFF;

  // A rectangle along the points of a node, in any direction: a polygon's outline is long and thin at every scale, and
  // so are the ears that pass along it.
  struct Vec2d {
    double x = 0, y = 0;
  };
  struct Box {
    Vec2d centre, along, across;  // and half of its sides
    // Whether all of the box certainly lies to the right of the line from a to b.
    bool IsRightOf(Point2 a, Point2 b) const;
  };

  struct Node {
    Point2 min, max;          // bounds of the points that it began with
    Box box;                  // and a tighter one
    uint32_t begin, end;      // its part of ids_; of a leaf, those that are left
    uint32_t count;           // points that are left
    uint32_t parent, second;  // the first child follows its parent; 0: a leaf
  };

  // The box of the points of ids, which lie between p and q in the axis in which they spread most.
  Box Enclose(std::span<const uint32_t> ids, Point2 p, Point2 q) const;
  uint32_t BuildNode(uint32_t begin, uint32_t end, uint32_t parent);

  std::span<const Point2> points_;
  std::vector<uint32_t> ids_;
  std::vector<uint32_t> place_;  // per id: its place in ids_, or kNowhere
  std::vector<uint32_t> leaf_;   // per id: its leaf
  std::vector<Node> nodes_;
};

}  // namespace deltaray

#endif  // SERVER_MESH_POINT_TREE_H_
