// The surface area heuristic: the expected cost of a ray through a node.

#ifndef SERVER_BUILD_SAH_H_
#define SERVER_BUILD_SAH_H_

#include <cstdint>

#include "server/build/config.h"

namespace deltaray {

// Ct and Ci. Costs are not divided by the root's area, so that a box without area needs no special case: they are
// areas (half ones, everywhere) times expected work.
struct SahCosts {
  double traversal = 1;
  double intersection = 1;

  explicit SahCosts(const Config& config) : traversal(config.traversal_cost), intersection(config.intersection_cost) {}

  double Leaf(double half_area, uint64_t references) const {
    return intersection * half_area * static_cast<double>(references);
  }
  // `children`: the sum over both children of half area times number of references.
  double Split(double half_area, double children) const { return traversal * half_area + intersection * children; }
};

}  // namespace deltaray

#endif  // SERVER_BUILD_SAH_H_
