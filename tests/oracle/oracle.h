// What is right: the answers to every query, by brute force in exact arithmetic.

#ifndef TESTS_ORACLE_ORACLE_H_
#define TESTS_ORACLE_ORACLE_H_

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "server/geometry/ray.h"
#include "server/geometry/triangles.h"
#include "tests/oracle/certain_miss.h"

namespace deltaray {

struct OracleHit {
  float t = 0;                         // exact t, rounded to nearest even; never -0
  float rounded_u = 0, rounded_v = 0;  // likewise
  double u = 0, v = 0;                 // exact u and v, within 2^-50
  uint32_t primitive = kNoPrimitive;
  bool back = false;
};

// Answers by the definition in server/geometry/README.md and by none of the server's code. Immutable and thread-safe.
class Oracle {
 public:
  // `triangles` must outlive the oracle.
  explicit Oracle(TrianglesView triangles);

  // The hit of least exact t, of several the one of the lowest primitive id. Any hit: whether there is one.
  std::optional<OracleHit> ClosestHit(const Ray& ray, Culling culling = Culling::kNone) const;

  // All hits, by exact t, then primitive id. Their count: how many there are.
  std::vector<OracleHit> AllHits(const Ray& ray, Culling culling = Culling::kNone) const;

  // The closest hits of many rays, on all processors.
  std::vector<std::optional<OracleHit>> ClosestHits(std::span<const Ray> rays, Culling culling = Culling::kNone) const;

  // The sign of (exact t at which `ray` meets `a`) - (that of `b`), or nullopt where it does not hit both.
  std::optional<int> CompareT(const Ray& ray, uint32_t a, uint32_t b) const;

 private:
  TrianglesView triangles_;
  MissFilter filter_;
};

}  // namespace deltaray

#endif  // TESTS_ORACLE_ORACLE_H_
