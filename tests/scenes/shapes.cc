#include "tests/scenes/shapes.h"

#include <cmath>
#include <numbers>

namespace deltaray {
namespace {

uint32_t AddVertex(TriangleMesh* mesh, Vec3d p) {
  mesh->positions.push_back(static_cast<Vec3f>(p));
  return static_cast<uint32_t>(mesh->positions.size() - 1);
}

void AddIndices(TriangleMesh* mesh, uint32_t a, uint32_t b, uint32_t c) {
  mesh->indices.push_back({a, b, c});
  ++mesh->face_count;
}

}  // namespace

Frame RandomFrame(Vec3d axis, Random& random) {
  while (true) {
    const Vec3d side = Cross(axis, random.OnUnitSphere());
    const double length = Length(side);
    if (length < 0.1) continue;
    const Vec3d second = (1 / length) * side;
    return {axis, second, Cross(axis, second)};
  }
}

void AddTriangle(TriangleMesh* mesh, Vec3d a, Vec3d b, Vec3d c) {
  const uint32_t first = AddVertex(mesh, a);
  AddVertex(mesh, b);
  AddVertex(mesh, c);
  AddIndices(mesh, first, first + 1, first + 2);
}

void AddParallelogram(TriangleMesh* mesh, Vec3d a, Vec3d u, Vec3d v) {
  const uint32_t first = AddVertex(mesh, a);
  AddVertex(mesh, a + u);
  AddVertex(mesh, a + u + v);
  AddVertex(mesh, a + v);
  AddIndices(mesh, first, first + 1, first + 2);
  AddIndices(mesh, first, first + 2, first + 3);
}

void AddBox(TriangleMesh* mesh, Vec3d centre, const Frame& frame, Vec3d half) {
  const uint32_t first = static_cast<uint32_t>(mesh->positions.size());
  for (int corner = 0; corner < 8; ++corner) {
    Vec3d p = centre;
    for (int axis = 0; axis < 3; ++axis) p = p + ((corner >> axis & 1) ? half[axis] : -half[axis]) * frame[axis];
    AddVertex(mesh, p);
  }
  static constexpr std::array<std::array<uint32_t, 4>, 6> kSides = {
      {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}}};
  for (const auto& [a, b, c, d] : kSides) {
    AddIndices(mesh, first + a, first + b, first + c);
    AddIndices(mesh, first + a, first + c, first + d);
  }
}

void AddSphere(TriangleMesh* mesh, Vec3d centre, double radius, uint32_t rings) {
  const uint32_t segments = 2 * rings;
  const uint32_t south = AddVertex(mesh, centre - Vec3d{0, 0, radius});
  for (uint32_t ring = 1; ring < rings; ++ring) {
    const double latitude = std::numbers::pi * (static_cast<double>(ring) / rings - 0.5);
    for (uint32_t segment = 0; segment < segments; ++segment) {
      const double longitude = 2 * std::numbers::pi * segment / segments;
      AddVertex(mesh, centre + radius * Vec3d{std::cos(latitude) * std::cos(longitude),
                                              std::cos(latitude) * std::sin(longitude), std::sin(latitude)});
    }
  }
  const uint32_t north = AddVertex(mesh, centre + Vec3d{0, 0, radius});
  const auto vertex = [&](uint32_t ring, uint32_t segment) {
    return south + 1 + (ring - 1) * segments + segment % segments;
  };
  for (uint32_t segment = 0; segment < segments; ++segment) {
    AddIndices(mesh, south, vertex(1, segment + 1), vertex(1, segment));
    AddIndices(mesh, north, vertex(rings - 1, segment), vertex(rings - 1, segment + 1));
    for (uint32_t ring = 1; ring + 1 < rings; ++ring) {
      AddIndices(mesh, vertex(ring, segment), vertex(ring, segment + 1), vertex(ring + 1, segment + 1));
      AddIndices(mesh, vertex(ring, segment), vertex(ring + 1, segment + 1), vertex(ring + 1, segment));
    }
  }
}

}  // namespace deltaray
