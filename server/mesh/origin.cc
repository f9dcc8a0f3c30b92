#include "server/mesh/origin.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

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

// Whether float32 holds all vertices, relative to `origin`, as exactly as it holds them relative to zero.
template <typename T>
bool StayExact(std::span<const Vec3<T>> vertices, const Vec3d& origin) {
  return std::ranges::all_of(vertices, [&origin](const Vec3<T>& vertex) {
    const Vec3d v = static_cast<Vec3d>(vertex);
    const Vec3f stored = StoredPosition(v, origin);
    for (int axis = 0; axis < 3; ++axis) {
      if (Rounding(v[axis], origin[axis], stored[axis]) != 0) return false;
    }
    return true;
  });
}

template <typename T>
Vec3d Choose(std::span<const Vec3<T>> vertices, std::span<const uint32_t> corners) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  Vec3d min{kInfinity, kInfinity, kInfinity}, max{-kInfinity, -kInfinity, -kInfinity};
  for (const uint32_t corner : corners) {
    const Vec3d v = static_cast<Vec3d>(vertices[corner]);
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
  for (const Vec3<T>& v : vertices) {
    if (!IsFinite(StoredPosition(static_cast<Vec3d>(v), origin))) return {};
  }
  const bool are_exact =
      std::ranges::all_of(vertices, [](const Vec3<T>& v) { return IsExactInFloat(static_cast<Vec3d>(v)); });
  return !are_exact || StayExact(vertices, origin) ? origin : Vec3d{};
}

}  // namespace

Vec3d ChooseOrigin(const PolygonMesh& mesh) { return Choose<double>(mesh.vertices, mesh.corners); }

Vec3d ChooseOrigin(const TriangleMesh& mesh) {
  if (mesh.indices.empty()) return {};
  return Choose<float>(mesh.positions, {mesh.indices.front().data(), 3 * mesh.indices.size()});
}

StoredPositions StorePositions(const std::vector<Vec3d>& vertices, const Vec3d& origin) {
  StoredPositions stored;
  stored.positions.reserve(vertices.size());
  for (const Vec3d& v : vertices) {
    const Vec3f position = StoredPosition(v, origin);
    for (int axis = 0; axis < 3; ++axis) {
      stored.max_rounding = std::max(stored.max_rounding, Rounding(v[axis], origin[axis], position[axis]));
    }
    stored.positions.push_back(position);
  }
  return stored;
}

}  // namespace deltaray
