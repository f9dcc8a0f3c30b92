// Splits of a set of references in two sets, each reference in one of them.

#ifndef SERVER_BUILD_OBJECT_SPLIT_H_
#define SERVER_BUILD_OBJECT_SPLIT_H_

#include <cstdint>
#include <limits>
#include <span>

#include "server/build/build_context.h"
#include "server/build/reference.h"
#include "server/geometry/bounds.h"

namespace deltaray {

// Where a reference stands along an axis: by centre, then by primitive. No two references of a node stand alike, since
// a node never has two references to one triangle.
struct SplitKey {
  double doubled_centre = 0;
  uint32_t primitive = 0;

  SplitKey() = default;
  SplitKey(double doubled_centre, uint32_t primitive) : doubled_centre(doubled_centre), primitive(primitive) {}
  SplitKey(const Reference& reference, int axis)
      : doubled_centre(reference.bounds.DoubledCentre(axis)), primitive(reference.primitive) {}

  friend bool operator<(const SplitKey& a, const SplitKey& b) {
    return a.doubled_centre != b.doubled_centre ? a.doubled_centre < b.doubled_centre : a.primitive < b.primitive;
  }
};

// References that stand before `first_right` along `axis` go left, the others right. Both sides have some.
struct ObjectSplit {
  // Sum over both sides of half area times number of references. Infinite: no split was found.
  double cost = std::numeric_limits<double>::infinity();
  int axis = 0;
  SplitKey first_right;
  Bounds left, right;

  bool IsFound() const { return cost < std::numeric_limits<double>::infinity(); }
  bool GoesLeft(const Reference& reference) const { return SplitKey(reference, axis) < first_right; }
};

// The cheapest object split of `references`, over all axes: exact for few references, by 32 bins of centres per axis
// for many [Wald 2007]. None is found for fewer than two references, or where all of many have the same centre.
ObjectSplit FindObjectSplit(std::span<const Reference> references, BuildContext& context);

// The cheapest of all object splits of `references`, by sorting them along each axis. None for fewer than two.
ObjectSplit SweepObjectSplit(std::span<const Reference> references);

// The split in halves along the axis in which `bounds` is widest. Changes the order of `references`. What is left when
// nothing else splits them. REQUIRES: references.size() >= 2.
ObjectSplit MedianSplit(std::span<Reference> references, const Bounds& bounds);

// Puts the left references before the right ones and returns the number of the left ones.
size_t Partition(std::span<Reference> references, const ObjectSplit& split, const BuildContext& context);

}  // namespace deltaray

#endif  // SERVER_BUILD_OBJECT_SPLIT_H_
