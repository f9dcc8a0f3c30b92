#include "server/build/object_split.h"

#include <algorithm>
#include <array>

#include "server/build/partition.h"

namespace deltaray {
namespace {

// More bins were measured to find splits that are no better.
constexpr int kBins = 16;

struct Bin {
  PackedBounds bounds;
  uint32_t count = 0;

  void Merge(const Bin& other) {
    bounds.Extend(other.bounds);
    count += other.count;
  }
};

struct Bins {
  PointBins points;
  std::array<std::array<Bin, kBins>, 3> bins;

  explicit Bins(const PointBins& points) : points(points) {}
  void Add(const Reference& reference) {
    const PackedBounds packed = reference.packed_bounds();
    const PackedInts at = points.At(packed.HalfCentre());
    for (int axis = 0; axis < 3; ++axis) {
      Bin& bin = bins[axis][at[axis]];
      bin.bounds.Extend(packed);
      ++bin.count;
    }
  }
  void Merge(const Bins& other) {
    for (int axis = 0; axis < 3; ++axis) {
      for (int i = 0; i < kBins; ++i) bins[axis][i].Merge(other.bins[axis][i]);
    }
  }
};

}  // namespace

ObjectSplit FindObjectSplit(std::span<const Reference> references, const BoundsSum& sum, const SahCosts& costs,
                            BuildContext& context) {
  Bins bins(PointBins(sum.half_centres, kBins));
  ReduceReferences(references, &bins, context);

  const float scale = UnitScale(static_cast<Bounds>(sum.bounds));
  float least = std::numeric_limits<float>::infinity();
  ObjectSplit best;
  Bin best_left, best_right;
  for (int axis = 0; axis < 3; ++axis) {
    if (!bins.points.CanCut(axis)) continue;
    // rights[i]: all bins from i on.
    std::array<Bin, kBins> rights;
    rights[kBins - 1] = bins.bins[axis][kBins - 1];
    for (int i = kBins - 2; i > 0; --i) {
      rights[i] = rights[i + 1];
      rights[i].Merge(bins.bins[axis][i]);
    }
    Bin left;
    for (int i = 1; i < kBins; ++i) {
      left.Merge(bins.bins[axis][i - 1]);
      const Bin& right = rights[i];
      if (left.count == 0 || right.count == 0) continue;
      const float cost = left.bounds.HalfArea(scale) * static_cast<float>(costs.Work(left.count)) +
                         right.bounds.HalfArea(scale) * static_cast<float>(costs.Work(right.count));
      if (!(cost < least)) continue;
      least = cost;
      best.axis = axis;
      best.bin = i;
      best_left = left;
      best_right = right;
    }
  }
  if (best.bin == 0) return best;
  best.bins = bins.points;
  best.left = static_cast<Bounds>(best_left.bounds);
  best.right = static_cast<Bounds>(best_right.bounds);
  best.cost = best.left.HalfArea() * costs.Work(best_left.count) + best.right.HalfArea() * costs.Work(best_right.count);
  return best;
}

size_t Partition(std::span<Reference> references, const ObjectSplit& split, BuildContext& context) {
  return PartitionReferences(
      references, [&](const Reference& r) { return split.GoesLeft(r); }, context);
}

size_t PartitionAtMedian(std::span<Reference> references, const Bounds& bounds) {
  const int axis = bounds.WidestAxis();
  const auto middle = references.begin() + references.size() / 2;
  // A node never has two references to one triangle, so that no two stand alike.
  std::nth_element(references.begin(), middle, references.end(), [axis](const Reference& a, const Reference& b) {
    const double a_centre = a.bounds.DoubledCentre(axis), b_centre = b.bounds.DoubledCentre(axis);
    return a_centre != b_centre ? a_centre < b_centre : a.primitive < b.primitive;
  });
  return static_cast<size_t>(middle - references.begin());
}

}  // namespace deltaray
