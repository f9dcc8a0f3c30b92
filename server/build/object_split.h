// Splits of a set of references in two sets, each reference in one of them.

#ifndef SERVER_BUILD_OBJECT_SPLIT_H_
#define SERVER_BUILD_OBJECT_SPLIT_H_

#include <cstddef>
#include <limits>
#include <span>

#include "server/build/build_context.h"
#include "server/build/point_bins.h"
#include "server/build/reduce_references.h"
#include "server/build/reference.h"
#include "server/build/sah.h"
#include "server/geometry/bounds.h"

namespace deltaray {

// References whose centre is in a bin below `bin` of `axis` go left, the others right. Both sides have some.
struct ObjectSplit {
  // Sum over both sides of half area times work. Infinite: no split was found.
  double cost = std::numeric_limits<double>::infinity();
  PointBins bins;  // of halves of centres
  int axis = 0;
  int bin = 0;
  Bounds left, right;

  bool IsFound() const { return cost < std::numeric_limits<double>::infinity(); }
  bool GoesLeft(const Reference& reference) const {
    const float half_centre = 0.25f * reference.bounds.min[axis] + 0.25f * reference.bounds.max[axis];
    return bins.At(half_centre, axis) < bin;
  }
};

// The cheapest of the object splits between bins of the references' centres, over all axes, 16 bins an axis [Wald
// 2007]. `sum`: of the same references. None is found where all centres are in one place.
ObjectSplit FindObjectSplit(std::span<const Reference> references, const BoundsSum& sum, const SahCosts& costs,
                            BuildContext& context);

// Puts the left references before the right ones and returns the number of the left ones. The same for any number of
// threads.
size_t Partition(std::span<Reference> references, const ObjectSplit& split, BuildContext& context);

// Does so for the split in halves along the axis in which `bounds` is widest: what is left when nothing else splits
// them. REQUIRES: references.size() >= 2.
size_t PartitionAtMedian(std::span<Reference> references, const Bounds& bounds);

}  // namespace deltaray

#endif  // SERVER_BUILD_OBJECT_SPLIT_H_
