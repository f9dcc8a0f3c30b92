// Which triangles a ray misses for certain, told in double: what spares the oracle most of its exact arithmetic. The
// bounds are derived in README.md.

#ifndef TESTS_ORACLE_CERTAIN_MISS_H_
#define TESTS_ORACLE_CERTAIN_MISS_H_

#include <cstdint>
#include <vector>

#include "server/geometry/ray.h"
#include "server/geometry/triangles.h"

namespace deltaray {

// A triangle that the ray may hit. Where it does, the exact t is within these.
struct Possible {
  uint32_t primitive = kNoPrimitive;
  double t_lower = 0, t_upper = 0;
};

// Groups of neighbouring triangles, each in a box. Immutable, and so thread-safe.
class MissFilter {
 public:
  explicit MissFilter(const TrianglesView& triangles);

  // Replaces `possible` by all triangles that `ray` does not miss for certain.
  void Find(const Ray& ray, std::vector<Possible>* possible) const;

 private:
  struct Corners {
    Vec3d v0, v1, v2;
    uint32_t primitive;
  };
  struct Group {
    Vec3d min, max;
    size_t begin, end;
  };

  // Orders corners_[begin, end), and makes groups of them.
  void Divide(size_t begin, size_t end);

  std::vector<Corners> corners_;
  std::vector<Group> groups_;
};

}  // namespace deltaray

#endif  // TESTS_ORACLE_CERTAIN_MISS_H_
