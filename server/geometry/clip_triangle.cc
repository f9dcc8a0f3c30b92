#include "server/geometry/clip_triangle.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace deltaray {
namespace {

// Rounding of a new corner, per coordinate, over the largest coordinate: at most 8 roundings of 2^-53.
constexpr double kCornerRounding = 0x1p-50;

// The part of a triangle on the inner side of some planes. Corner i lies within `error` of corner i of an exactly
// convex polygon that holds the exact part; see README.md.
class Polygon {
 public:
  explicit Polygon(const Triangle& triangle) : bounds_(triangle.GetBounds()), size_(3) {
    for (int axis = 0; axis < 3; ++axis) {
      corners_[0][axis] = triangle.v0[axis];
      corners_[1][axis] = triangle.v1[axis];
      corners_[2][axis] = triangle.v2[axis];
      step_[axis] = kCornerRounding * std::max(std::abs(static_cast<double>(bounds_.min[axis])),
                                               std::abs(static_cast<double>(bounds_.max[axis])));
    }
  }

  // Cuts away what lies beyond each face of `box`.
  void ClipTo(const Bounds& box) {
    for (int axis = 0; axis < 3; ++axis) {
      if (box.min[axis] > bounds_.min[axis]) Clip(axis, box.min[axis], -1);
      if (box.max[axis] < bounds_.max[axis]) Clip(axis, box.max[axis], 1);
    }
  }

  // Cuts away what has a coordinate greater than `position` where side is 1, less where side is -1.
  void Clip(int axis, double position, double side) {
    // Cut a little beyond the plane, so that what is cut away lies beyond it for certain in spite of the errors.
    const double limit = side * position + error_[axis] + 2 * step_[axis];
    Corners kept;
    int kept_size = 0;
    for (int i = 0; i < size_; ++i) {
      const Corner& a = corners_[i];
      const Corner& b = corners_[i + 1 == size_ ? 0 : i + 1];
      const double a_side = side * a[axis], b_side = side * b[axis];
      if (a_side <= limit) kept[kept_size++] = a;
      if (a_side <= limit && b_side > limit) {
        kept[kept_size++] = Between(a, b, (limit - a_side) / (b_side - a_side));
      } else if (a_side > limit && b_side <= limit) {
        kept[kept_size++] = Between(b, a, (limit - b_side) / (a_side - b_side));
      }
    }
    std::copy_n(kept.begin(), kept_size, corners_.begin());
    size_ = kept_size;
    error_ = error_ + step_;
  }

  // The corners' bounds with their errors, rounded outward to float32.
  Bounds GetBounds() const {
    Bounds result;
    for (int axis = 0; axis < 3; ++axis) {
      double least = Bounds::kInfinity, greatest = -Bounds::kInfinity;
      for (int i = 0; i < size_; ++i) {
        least = std::min(least, corners_[i][axis]);
        greatest = std::max(greatest, corners_[i][axis]);
      }
      // The triangle's own bounds are exact, so that flat triangles keep flat bounds.
      result.min[axis] = std::max(RoundDown(least - 2 * error_[axis]), bounds_.min[axis]);
      result.max[axis] = std::min(RoundUp(greatest + 2 * error_[axis]), bounds_.max[axis]);
    }
    return result;
  }

 private:
  // A cut adds at most one corner for each two that there are: 3, 4, 6, 9, 13, 19, 28 and 42 after seven cuts. Exactly
  // convex polygons would stay below 10; rounding may make them a little uneven.
  static constexpr int kMaxCorners = 42;
  // Uninitialised: filling them would take longer than a cut does.
  using Corner = std::array<double, 3>;
  using Corners = std::array<Corner, kMaxCorners>;

  static Corner Between(const Corner& a, const Corner& b, double ratio) {
    return {a[0] + ratio * (b[0] - a[0]), a[1] + ratio * (b[1] - a[1]), a[2] + ratio * (b[2] - a[2])};
  }

  static float RoundDown(double x) {
    const float f = static_cast<float>(x);
    return f > x ? std::nextafter(f, -Bounds::kInfinity) : f;
  }
  static float RoundUp(double x) {
    const float f = static_cast<float>(x);
    return f < x ? std::nextafter(f, Bounds::kInfinity) : f;
  }

  Bounds bounds_;
  Vec3d step_;   // the rounding that one cut may add
  Vec3d error_;  // the sum of it
  Corners corners_;
  int size_;
};

}  // namespace

Bounds ClipTriangle(const Triangle& triangle, const Bounds& box) {
  if (box.IsEmpty()) return Bounds();
  const Bounds bounds = triangle.GetBounds();
  const Bounds common = Intersection(bounds, box);
  if (common.IsEmpty() || common == bounds) return common;
  Polygon polygon(triangle);
  polygon.ClipTo(box);
  return Intersection(polygon.GetBounds(), box);
}

void SplitTriangle(const Triangle& triangle, int axis, float position, const Bounds& box, Bounds* left, Bounds* right) {
  Bounds left_box = box, right_box = box;
  left_box.max[axis] = std::min(box.max[axis], position);
  right_box.min[axis] = std::max(box.min[axis], position);
  const Bounds common = Intersection(triangle.GetBounds(), box);
  if (common.IsEmpty() || common.max[axis] < position || common.min[axis] > position) {
    *left = ClipTriangle(triangle, left_box);
    *right = ClipTriangle(triangle, right_box);
    return;
  }
  Polygon left_part(triangle);
  left_part.ClipTo(box);
  Polygon right_part = left_part;
  left_part.Clip(axis, position, 1);
  right_part.Clip(axis, position, -1);
  *left = Intersection(left_part.GetBounds(), left_box);
  *right = Intersection(right_part.GetBounds(), right_box);
}

}  // namespace deltaray
