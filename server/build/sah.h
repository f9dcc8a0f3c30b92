// The surface area heuristic: the expected cost of a ray through a node.

#ifndef SERVER_BUILD_SAH_H_
#define SERVER_BUILD_SAH_H_

#include <cstdint>

#include "server/build/config.h"
#include "server/tree/wide_node.h"

namespace deltaray {

// Leaves of the hybrid's finished tree are tested in groups of 2^kLeafGroupShift references.
inline constexpr uint32_t kLeafGroupShift = 3;
static_assert(1u << kLeafGroupShift == kMaxLeafTriangles);

// Ct and Ci. Costs are not divided by the root's area, so that a box without area needs no special case: they are
// areas (half ones, everywhere) times expected work.
struct SahCosts {
  double traversal = 1;
  double intersection = 1;
  // A group of 2^group_shift references that is begun costs as much as a full one.
  uint32_t group_shift = 0;

  explicit SahCosts(const Config& config)
      : traversal(config.traversal_cost),
        intersection(config.intersection_cost),
        group_shift(config.builder == Builder::kHybrid ? kLeafGroupShift : 0) {}

  // References, groups counted as full ones.
  uint32_t Work(uint32_t references) const {
    const uint32_t group = 1u << group_shift;
    return (references + group - 1) >> group_shift << group_shift;
  }
  double Leaf(double half_area, uint32_t references) const { return intersection * half_area * Work(references); }
  // `children`: the sum over both children of half area times work.
  double Split(double half_area, double children) const { return traversal * half_area + intersection * children; }
};

}  // namespace deltaray

#endif  // SERVER_BUILD_SAH_H_
