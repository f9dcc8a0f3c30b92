// From polygons to triangles.

#ifndef SERVER_MESH_TRIANGULATE_H_
#define SERVER_MESH_TRIANGULATE_H_

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "server/geometry/vec3.h"

namespace deltaray {

// Makes triangles of polygons; keeps its working memory from one to the next.
class Triangulator {
 public:
  // `positions` are finite and must outlive it.
  explicit Triangulator(std::span<const Vec3f> positions) : positions_(positions) {}

  // Appends n - 2 triangles of the polygon with these n >= 3 corners to `triangles`, in the polygon's orientation.
  // False where it is not a simple polygon.
  bool Append(std::span<const uint32_t> corners, std::vector<std::array<uint32_t, 3>>* triangles);

 private:
  std::span<const Vec3f> positions_;
};

}  // namespace deltaray

#endif  // SERVER_MESH_TRIANGULATE_H_
