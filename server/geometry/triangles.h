// A view of the triangles of a mesh.

#ifndef SERVER_GEOMETRY_TRIANGLES_H_
#define SERVER_GEOMETRY_TRIANGLES_H_

#include <array>
#include <cstdint>
#include <span>

#include "server/geometry/bounds.h"
#include "server/geometry/vec3.h"

namespace deltaray {

// The corners of one triangle.
struct Triangle {
  Vec3f v0, v1, v2;

  Bounds GetBounds() const {
    Bounds b;
    b.Extend(v0);
    b.Extend(v1);
    b.Extend(v2);
    return b;
  }
};

// Indexed triangles that somebody else owns. Every index is below positions.size(), every coordinate finite.
struct TrianglesView {
  std::span<const Vec3f> positions;
  std::span<const std::array<uint32_t, 3>> indices;

  size_t size() const { return indices.size(); }
  Triangle operator[](size_t i) const {
    const auto& [a, b, c] = indices[i];
    return {positions[a], positions[b], positions[c]};
  }
};

}  // namespace deltaray

#endif  // SERVER_GEOMETRY_TRIANGLES_H_
