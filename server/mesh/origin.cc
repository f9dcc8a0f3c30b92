#include "server/mesh/origin.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace deltaray {
namespace {

bool IsExactInFloat(const Vec3d& v) { return static_cast<Vec3d>(static_cast<Vec3f>(v)) == v; }

// The exact difference between the stored coordinate and the given one, rounded once.
double Rounding(double given, double origin, float stored) {
  // The difference, and what rounding took off it [Knuth, TwoSum].
  const double difference = given - origin;
  const double taken = difference - given;
  const double lost = (given - (difference - taken)) - (origin + taken);
  // The stored value is the nearest float to the difference, so that subtracting the two is exact.
  return std::abs((stored - difference) - lost);
}

// Whether float32 holds the vertices of faces, relative to `origin`, as exactly as it holds them relative to zero.
bool StaysExact(const PolygonMesh& mesh, const Vec3d& origin) {
  for (const uint32_t corner : mesh.corners) {
    const Vec3d& v = mesh.vertices[corner];
    const Vec3f stored = static_cast<Vec3f>(v - origin);
    for (int axis = 0; axis < 3; ++axis) {
      if (Rounding(v[axis], origin[axis], stored[axis]) != 0) return false;
    }
  }
  return true;
}

}  // namespace

Vec3d ChooseOrigin(const PolygonMesh& mesh) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  Vec3d min{kInfinity, kInfinity, kInfinity}, max{-kInfinity, -kInfinity, -kInfinity};
  bool exact = true;
  for (const uint32_t corner : mesh.corners) {
    const Vec3d& v = mesh.vertices[corner];
    exact = exact && IsExactInFloat(v);
    for (int axis = 0; axis < 3; ++axis) {
      min[axis] = std::min(min[axis], v[axis]);
      max[axis] = std::max(max[axis], v[axis]);
    }
  }
  double extent = 0, farthest = 0;
  for (int axis = 0; axis < 3; ++axis) {
    extent = std::max(extent, max[axis] - min[axis]);
    farthest = std::max({farthest, std::abs(min[axis]), std::abs(max[axis])});
  }
  constexpr double kFar = 16;
  if (extent == 0 || farthest <= kFar * extent) return {};

  int exponent;
  const double step = std::frexp(extent, &exponent) == 0.5 ? extent : std::ldexp(1, exponent);
  Vec3d origin;
  for (int axis = 0; axis < 3; ++axis) {
    origin[axis] = std::nearbyint((min[axis] + max[axis]) / 2 / step) * step + 0.0;
  }
  // A vertex that no face uses may lie anywhere; it must not leave the range either.
  for (const Vec3d& v : mesh.vertices) {
    if (!IsFinite(static_cast<Vec3f>(v - origin))) return {};
  }
  return !exact || StaysExact(mesh, origin) ? origin : Vec3d{};
}

StoredPositions StorePositions(const std::vector<Vec3d>& vertices, const Vec3d& origin) {
  StoredPositions stored;
  stored.positions.reserve(vertices.size());
  for (const Vec3d& v : vertices) {
    // Adding zero turns -0 into +0.
    const Vec3f position = static_cast<Vec3f>(v - origin) + Vec3f{0, 0, 0};
    for (int axis = 0; axis < 3; ++axis) {
      stored.max_rounding = std::max(stored.max_rounding, Rounding(v[axis], origin[axis], position[axis]));
    }
    stored.positions.push_back(position);
  }
  return stored;
}

}  // namespace deltaray
