#include "server/service/triangle_normal.h"

#include <algorithm>
#include <cmath>

#include "boost/multiprecision/cpp_bin_float.hpp"

namespace deltaray {
namespace {

// Differences of floats are multiples of 2^-149 below 2^129, their products multiples of 2^-298 below 2^258: with 600
// bits nothing below is ever rounded, but the last conversion.
using Exact =
    boost::multiprecision::number<boost::multiprecision::cpp_bin_float<600, boost::multiprecision::digit_base_2>,
                                  boost::multiprecision::et_off>;

Vec3d ExactCross(const Triangle& triangle) {
  const auto edge = [&triangle](Vec3f to, int axis) { return Exact(to[axis]) - Exact(triangle.v0[axis]); };
  Vec3d cross;
  for (int axis = 0; axis < 3; ++axis) {
    const int y = (axis + 1) % 3;
    const int z = (axis + 2) % 3;
    cross[axis] =
        static_cast<double>(edge(triangle.v1, y) * edge(triangle.v2, z) - edge(triangle.v1, z) * edge(triangle.v2, y));
  }
  return cross;
}

}  // namespace

Vec3f GeometricNormal(const Triangle& triangle) {
  const Vec3d a = static_cast<Vec3d>(triangle.v1) - static_cast<Vec3d>(triangle.v0);
  const Vec3d b = static_cast<Vec3d>(triangle.v2) - static_cast<Vec3d>(triangle.v0);
  Vec3d normal = Cross(a, b);
  // The cross product is off by at most 2^-50 |a| |b|. Where it is shorter than 2^-24 |a| |b| that is too much.
  if (!(Dot(normal, normal) > 0x1p-48 * Dot(a, a) * Dot(b, b))) normal = ExactCross(triangle);
  // In double the squares neither overflow nor vanish: floats range from 2^-149 to 2^128, so these from 2^-596 to
  // 2^520.
  const double length = Length(normal);
  if (length == 0) return {};
  return static_cast<Vec3f>((1 / length) * normal);
}

}  // namespace deltaray
