// Bins of equal width along each axis, between which splits are looked for.

#ifndef SERVER_BUILD_POINT_BINS_H_
#define SERVER_BUILD_POINT_BINS_H_

#include <algorithm>
#include <cmath>

#include "server/geometry/packed_bounds.h"

namespace deltaray {

// Numbers the bins from the least to the greatest coordinate. The numbers are monotone along each axis, and the same
// whether all axes are asked for at once or one.
class PointBins {
 public:
  PointBins() = default;
  // Points lie in `points`. REQUIRES: count > 0.
  PointBins(const PackedBounds& points, int count) : first_(points.min), count_(count) {
    for (int axis = 0; axis < 3; ++axis) {
      const float per_unit = static_cast<float>(count) / (points.max[axis] - points.min[axis]);
      if (std::isfinite(per_unit)) per_unit_[axis] = per_unit;
    }
  }

  int count() const { return count_; }
  // Not where the points have no width along `axis`, or one that is too small or too large to tell: all are in bin 0.
  bool CanCut(int axis) const { return per_unit_[axis] != 0; }

  // The bin of a point: the last one that begins at or before it.
  PackedInts At(PackedFloats point) const { return Floor((point - first_) * per_unit_); }
  int At(float x, int axis) const { return Floor((x - first_[axis]) * per_unit_[axis]); }

  // The last bin that begins before a point, -1 where none does: what only touches a plane from below is below it.
  PackedInts Before(PackedFloats point) const {
    const PackedFloats place = (point - first_) * per_unit_;
    const PackedInts bin = Floor(place);
    // The comparison gives -1 where it holds.
    return bin - 1 - (__builtin_convertvector(bin, PackedFloats) < place);
  }
  int Before(float x, int axis) const {
    const float place = (x - first_[axis]) * per_unit_[axis];
    const int bin = Floor(place);
    return static_cast<float>(bin) < place ? bin : bin - 1;
  }

 private:
  PackedInts Floor(PackedFloats place) const {
    const float last = static_cast<float>(count_ - 1);
    return __builtin_convertvector(Least(place, PackedFloats{last, last, last, last}), PackedInts);
  }
  int Floor(float place) const { return static_cast<int>(std::min(place, static_cast<float>(count_ - 1))); }

  PackedFloats first_{};
  PackedFloats per_unit_{};
  int count_ = 1;
};

}  // namespace deltaray

#endif  // SERVER_BUILD_POINT_BINS_H_
