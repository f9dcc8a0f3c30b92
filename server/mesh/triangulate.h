// From polygons to triangles.

#ifndef SERVER_MESH_TRIANGULATE_H_
#define SERVER_MESH_TRIANGULATE_H_

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "server/geometry/vec3.h"
#include "server/mesh/orientation.h"
#include "server/mesh/point_tree.h"

namespace deltaray {

// Makes triangles of polygons by clipping ears. Keeps its working memory from one polygon to the next. Not thread-safe.
//
// A polygon is seen along the axis in which the normal of its area [Newell] is longest. That leaves two float32
// coordinates of each corner as they are, so that all decisions are exact, and the areas of the triangles add up to the
// polygon's in that view; in space too where the polygon is flat. It must be simple in that view: no edge crosses
// another, though edges may touch, as those do that join a hole to the outline. Corners may repeat and lie on one line.
class Triangulator {
 public:
  using Triangles = std::vector<std::array<uint32_t, 3>>;

  // `positions` are finite and must outlive it.
  explicit Triangulator(std::span<const Vec3f> positions) : positions_(positions) {}

  // Appends the n - 2 triangles of the polygon with these n >= 3 corners to `triangles`; each turns as the polygon
  // does. They have an area wherever the polygon lets them. False where the polygon is not simple, or has no area: then
  // they are a fan. Takes little more than n log n time on polygons as they come; the points that may lie in an ear are
  // found in a kd-tree.
  bool Append(std::span<const uint32_t> corners, Triangles* triangles);

 private:
  void Project();
  void FindTurns();
  // 1, 0 or -1: the corner turns to the left, not at all, or to the right.
  int Turn(uint32_t corner) const;
  // Whether the direction of the edges goes round once, to the left. It does in every simple polygon.
  bool TurnsOnce() const;
  bool SplitQuad(Triangles* triangles) const;
  bool ClipEars(Triangles* triangles);
  void Clip(uint32_t corner, Triangles* triangles);
  void Update(uint32_t corner);
  void Enqueue(uint32_t corner);
  void Emit(uint32_t a, uint32_t b, uint32_t c, Triangles* triangles) const {
    triangles->push_back({corners_[a], corners_[b], corners_[c]});
  }

  std::span<const Vec3f> positions_;

  // Of the current polygon, per corner:
  std::span<const uint32_t> corners_;
  std::vector<Point2> points_;
  std::vector<int8_t> turns_;
  std::vector<uint32_t> previous_, next_;  // among those that are not clipped
  std::vector<bool> clipped_, queued_;

  PointTree obstacles_;          // corners that do not turn to the left
  std::vector<uint32_t> queue_;  // corners that may be ears, in the order in which they are tried
  std::vector<uint32_t> flat_;   // corners that were seen without a turn
};

}  // namespace deltaray

#endif  // SERVER_MESH_TRIANGULATE_H_
