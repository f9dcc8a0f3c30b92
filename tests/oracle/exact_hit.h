// One ray against one triangle in exact numbers: the definition, written down.

#ifndef TESTS_ORACLE_EXACT_HIT_H_
#define TESTS_ORACLE_EXACT_HIT_H_

#include <optional>

#include "server/geometry/ray.h"
#include "server/geometry/triangles.h"
#include "tests/oracle/dyadic.h"

namespace deltaray {

struct ExactHit {
  Quotient t, u, v;
  bool back = false;
};

// Where `ray` hits `triangle`, if it does: by the signs of the three volumes that the ray's line spans with the edges,
// not by the formulas of the server. Does not look at ray.excluded_primitive.
std::optional<ExactHit> FindExactHit(const Ray& ray, const Triangle& triangle);

}  // namespace deltaray

#endif  // TESTS_ORACLE_EXACT_HIT_H_
