#include "server/mesh/orientation.h"

#include <cmath>

namespace deltaray {
namespace {

int Sign(double value) { return (value > 0) - (value < 0); }

// The sign of the exact sum of `terms`, by an expansion that grows by one term at a time [Shewchuk 1997, section 2.4].
template <int n>
int SignOfSum(const double (&terms)[n]) {
  double parts[n] = {};  // Do not overlap; the last one that is not zero is the largest.
  for (int count = 0; count < n; ++count) {
    double sum = terms[count];
    for (int i = 0; i < count; ++i) {
      const double part = parts[i], total = sum + part;
      const double back = total - sum;
      parts[i] = (sum - (total - back)) + (part - back);
      sum = total;
    }
    parts[count] = sum;
  }
  for (int i = n - 1; i >= 0; --i) {
    if (parts[i] != 0) return Sign(parts[i]);
  }
  return 0;
}

}  // namespace

int Orientation(Point2 a, Point2 b, Point2 c) {
  const double left = (double{a.x} - c.x) * (double{b.y} - c.y);
  const double right = (double{a.y} - c.y) * (double{b.x} - c.x);
  const double determinant = left - right;
  // [Shewchuk 1997], the first error bound of ORIENT2D. Products of float32 do not underflow in double.
  constexpr double kEpsilon = 0x1p-53;
  constexpr double kBound = (3 + 16 * kEpsilon) * kEpsilon;
  if (std::abs(determinant) > kBound * (std::abs(left) + std::abs(right))) return Sign(determinant);
  // Multiplied out, each product of two float32 is exact in double.
  const double ax = a.x, ay = a.y, bx = b.x, by = b.y, cx = c.x, cy = c.y;
  return SignOfSum({ax * by, -ay * bx, bx * cy, -by * cx, cx * ay, -cy * ax});
}

}  // namespace deltaray
