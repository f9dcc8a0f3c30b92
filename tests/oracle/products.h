// The products of vectors that the oracle needs: its own, so that a mistake in the server's cannot hide behind itself.

#ifndef TESTS_ORACLE_PRODUCTS_H_
#define TESTS_ORACLE_PRODUCTS_H_

#include "server/geometry/vec3.h"

namespace deltaray {

template <typename T>
T DotProduct(const Vec3<T>& a, const Vec3<T>& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}

template <typename T>
Vec3<T> CrossProduct(const Vec3<T>& a, const Vec3<T>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

}  // namespace deltaray

#endif  // TESTS_ORACLE_PRODUCTS_H_
