// The ray-triangle test in exact arithmetic: slow, and right always. What triangle_test.h falls back on.

#ifndef SERVER_GEOMETRY_EXACT_TRIANGLE_H_
#define SERVER_GEOMETRY_EXACT_TRIANGLE_H_

#include <cstdint>

#include "server/geometry/ray.h"
#include "server/geometry/triangle_test.h"
#include "server/geometry/triangles.h"

namespace deltaray {

// How many of the following questions the calling thread has had answered so far.
uint64_t ExactDecisions();

// As IsDegenerate.
bool ExactIsDegenerate(const Triangle& triangle);

// As TestTriangle, but for candidate->primitive, which it leaves alone.
bool ExactTestTriangle(const Ray& ray, const Triangle& triangle, Culling culling, Candidate* candidate);

// -1, 0 or 1: whether the exact t of `a` along `ray` is less than, equal to or greater than that of `b`.
// REQUIRES: neither triangle is parallel to the ray.
int ExactCompareT(const Ray& ray, const Triangle& a, const Triangle& b);

// The exact t, u and v of the ray's line, rounded to nearest even. REQUIRES: the triangle is not parallel to the ray.
void ExactRound(const Ray& ray, const Triangle& triangle, float* t, float* u, float* v);

}  // namespace deltaray

#endif  // SERVER_GEOMETRY_EXACT_TRIANGLE_H_
