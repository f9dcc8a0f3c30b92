// The ray-triangle test in double, decided exactly where double cannot decide.

#ifndef SERVER_GEOMETRY_TRIANGLE_TEST_H_
#define SERVER_GEOMETRY_TRIANGLE_TEST_H_

#include <cstdint>

#include "server/geometry/ray.h"
#include "server/geometry/triangles.h"

namespace deltaray {

// Whether the triangle has exactly zero area. Such a triangle hits no ray.
bool IsDegenerate(const Triangle& triangle);

// A triangle that the ray's line hits within [t_min, t_max], as far as it was worked out: t, u, v in double with bounds
// on their errors. Order by exact t is decided by Before.
struct Candidate {
  double t = 0, t_error = 0;  // |t - exact t| <= t_error; t - t_error and t + t_error bound it as rounded, too
  double u = 0, u_error = 0;  // likewise
  double v = 0, v_error = 0;  // likewise
  uint32_t primitive = kNoPrimitive;
  bool back = false;

  double t_lower() const { return t - t_error; }
  double t_upper() const { return t + t_error; }
};

// Whether `ray` hits `triangle`, as exact arithmetic decides: the triangle is a closed set, t_min and t_max are
// included, coplanar rays and degenerate triangles do not hit, sides in `culling` are ignored. Fills `candidate` where
// it does. Does not look at ray.excluded_primitive.
bool TestTriangle(const Ray& ray, const Triangle& triangle, uint32_t primitive, Culling culling, Candidate* candidate);

// Whether a comes before b along `ray`: by exact t, then by primitive id. Both are hits of that ray.
bool Before(const Ray& ray, const TrianglesView& triangles, const Candidate& a, const Candidate& b);

// The hit with the exact values of t, u and v, each rounded to nearest even; never -0. So its bits do not depend on how
// the candidate was found. t is +inf where the exact one is beyond float32's range.
Hit Round(const Ray& ray, const TrianglesView& triangles, const Candidate& candidate);

}  // namespace deltaray

#endif  // SERVER_GEOMETRY_TRIANGLE_TEST_H_
