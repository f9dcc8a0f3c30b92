#include "tests/oracle/certain_miss.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace deltaray {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr size_t kGroupSize = 32;

// See README.md: volumes are off by less than this part of their permanents, slabs' crossings by less than that part of
// themselves.
constexpr double kVolumeError = 0x1p-48;
constexpr double kCrossingError = 0x1p-48;

// A volume as worked out in double, and a bound on its error.
struct Volume {
  double value, error;

  bool IsPositive() const { return value > error; }
  bool IsNegative() const { return value < -error; }
};

// a · (b × c)
Volume VolumeOf(Vec3d a, Vec3d b, Vec3d c) {
  const double yz = b.y * c.z, zy = b.z * c.y, zx = b.z * c.x, xz = b.x * c.z, xy = b.x * c.y, yx = b.y * c.x;
  const double permanent = std::abs(a.x) * (std::abs(yz) + std::abs(zy)) +
                           std::abs(a.y) * (std::abs(zx) + std::abs(xz)) +
                           std::abs(a.z) * (std::abs(xy) + std::abs(yx));
  return {a.x * (yz - zy) + a.y * (zx - xz) + a.z * (xy - yx), kVolumeError * permanent};
}

// Whether the closed box has a point of the ray within [t_min, t_max], or may have.
bool MayMeet(const Ray& ray, Vec3d min, Vec3d max) {
  double first = ray.t_min, last = ray.t_max;
  for (int axis = 0; axis < 3; ++axis) {
    const double o = ray.origin[axis], d = ray.direction[axis];
    if (d == 0) {
      if (o < min[axis] || o > max[axis]) return false;
      continue;
    }
    const double near = ((d > 0 ? min[axis] : max[axis]) - o) / d, far = ((d > 0 ? max[axis] : min[axis]) - o) / d;
    first = std::max(first, near - kCrossingError * std::abs(near));
    last = std::min(last, far + kCrossingError * std::abs(far));
  }
  return first <= last;
}

}  // namespace

MissFilter::MissFilter(const TrianglesView& triangles) {
  corners_.reserve(triangles.size());
  for (size_t i = 0; i < triangles.size(); ++i) {
    const Triangle t = triangles[i];
    corners_.push_back(
        {static_cast<Vec3d>(t.v0), static_cast<Vec3d>(t.v1), static_cast<Vec3d>(t.v2), static_cast<uint32_t>(i)});
  }
  if (!corners_.empty()) Divide(0, corners_.size());
}

void MissFilter::Divide(size_t begin, size_t end) {
  Vec3d min{kInfinity, kInfinity, kInfinity}, max{-kInfinity, -kInfinity, -kInfinity};
  for (size_t i = begin; i < end; ++i) {
    for (const Vec3d& p : {corners_[i].v0, corners_[i].v1, corners_[i].v2}) {
      for (int axis = 0; axis < 3; ++axis) {
        min[axis] = std::min(min[axis], p[axis]);
        max[axis] = std::max(max[axis], p[axis]);
      }
    }
  }
  if (end - begin <= kGroupSize) {
    groups_.push_back({min, max, begin, end});
    return;
  }
  const Vec3d size = max - min;
  const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
  const size_t middle = begin + (end - begin) / 2;
  std::nth_element(corners_.begin() + begin, corners_.begin() + middle, corners_.begin() + end,
                   [axis](const Corners& a, const Corners& b) {
                     return a.v0[axis] + a.v1[axis] + a.v2[axis] < b.v0[axis] + b.v1[axis] + b.v2[axis];
                   });
  Divide(begin, middle);
  Divide(middle, end);
}

void MissFilter::Find(const Ray& ray, std::vector<Possible>* possible) const {
  possible->clear();
  const auto o = static_cast<Vec3d>(ray.origin), d = static_cast<Vec3d>(ray.direction);
  for (const Group& group : groups_) {
    if (!MayMeet(ray, group.min, group.max)) continue;
    for (size_t i = group.begin; i < group.end; ++i) {
      const Corners& corners = corners_[i];
      const Vec3d a = corners.v0 - o, b = corners.v1 - o, c = corners.v2 - o;
      const Volume weights[] = {VolumeOf(d, b, c), VolumeOf(d, c, a), VolumeOf(d, a, b)};
      const auto positive = [](const Volume& w) { return w.IsPositive(); };
      const auto negative = [](const Volume& w) { return w.IsNegative(); };
      if (std::ranges::any_of(weights, positive) && std::ranges::any_of(weights, negative)) continue;

      const Vec3d e1 = corners.v1 - corners.v0, e2 = corners.v2 - corners.v0;
      const Volume sum = VolumeOf(d, e1, e2), volume = VolumeOf(a, e1, e2);
      Possible found{corners.primitive, -kInfinity, kInfinity};
      if (sum.IsPositive() || sum.IsNegative()) {
        const double t = volume.value / sum.value;
        const double error = 1.001 * (volume.error + std::abs(t) * sum.error) / (std::abs(sum.value) - sum.error) +
                             kCrossingError * std::abs(t);
        found.t_lower = t - error;
        found.t_upper = t + error;
      } else if (sum.error == 0) {
        continue;
      }
      if (found.t_upper < ray.t_min || found.t_lower > ray.t_max) continue;
      possible->push_back(found);
    }
  }
}

}  // namespace deltaray
