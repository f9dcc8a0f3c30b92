// Splits of a node's cell by a plane; a triangle that it cuts may get a reference on either side. [Stich 2009]

#ifndef SERVER_BUILD_SPATIAL_SPLIT_H_
#define SERVER_BUILD_SPATIAL_SPLIT_H_

#include <cstddef>
#include <limits>
#include <span>
#include <utility>

#include "server/build/build_context.h"
#include "server/build/point_bins.h"
#include "server/build/reference.h"
#include "server/build/sah.h"
#include "server/geometry/bounds.h"
#include "server/geometry/triangles.h"

namespace deltaray {

// The plane below `bin` of `axis`, at coordinate `position` but for rounding: sides go by the bins, cuts by the
// position.
struct SpatialSplit {
  // Sum over both sides of half area times work, every reference that the plane cuts being in both. Infinite: no split
  // was found.
  double cost = std::numeric_limits<double>::infinity();
  PointBins bins;
  int axis = 0;
  int bin = 0;
  float position = 0;

  bool IsFound() const { return cost < std::numeric_limits<double>::infinity(); }
};

// The cheapest of the planes that cut `bounds` in 16 bins along each axis in which it is at least half as wide as in
// the widest, by chopped binning with the triangles clipped to the bins. Only of those that leave fewer references than
// there are on each side and cut at most `room`; none where there is no such plane. `bounds`: the box of the
// references.
SpatialSplit FindSpatialSplit(std::span<const Reference> references, const TrianglesView& triangles,
                              const Bounds& bounds, const SahCosts& costs, size_t room, BuildContext& context);

// Sorts the `count` references at the front of `references` to the sides of `split`: left ones first, right ones
// behind. One that the plane cuts is cut in two, the right part being added behind the others, or goes whole to one
// side where that is cheaper ("reference unsplitting"). Returns the numbers of left and right ones. The same for any
// number of threads. REQUIRES: `references` has room for one more for each that the plane cuts.
std::pair<size_t, size_t> Partition(std::span<Reference> references, size_t count, const TrianglesView& triangles,
                                    const SpatialSplit& split, BuildContext& context);

}  // namespace deltaray

#endif  // SERVER_BUILD_SPATIAL_SPLIT_H_
