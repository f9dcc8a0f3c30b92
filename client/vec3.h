// Vectors of three doubles.

#ifndef CLIENT_VEC3_H_
#define CLIENT_VEC3_H_

#include <array>
#include <cmath>

#include "deltaray/v1/mesh.pb.h"

namespace deltaray {

using Vec3 = std::array<double, 3>;

inline Vec3 FromPoint(const v1::Point& point) { return {point.x(), point.y(), point.z()}; }

inline Vec3 Add(const Vec3& a, const Vec3& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
inline Vec3 Subtract(const Vec3& a, const Vec3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
inline Vec3 Scale(const Vec3& a, double s) { return {a[0] * s, a[1] * s, a[2] * s}; }
inline double Dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
inline double Length(const Vec3& a) { return std::hypot(a[0], a[1], a[2]); }
// Divides, since one over a tiny length is infinite.
inline Vec3 Normalize(const Vec3& a) {
  const double length = Length(a);
  return {a[0] / length, a[1] / length, a[2] / length};
}
inline Vec3 Cross(const Vec3& a, const Vec3& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

}  // namespace deltaray

#endif  // CLIENT_VEC3_H_
