#include "server/build/object_split.h"

#include <algorithm>
#include <array>
#include <vector>

#include "server/build/reduce_references.h"

namespace deltaray {
namespace {

constexpr int kBins = 32;
// Up to here the exact sweep is worth its sorting.
constexpr size_t kSweepReferences = 32;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// The range of doubled centres.
struct CentreRange {
  std::array<double, 3> min{kInfinity, kInfinity, kInfinity};
  std::array<double, 3> max{-kInfinity, -kInfinity, -kInfinity};

  void Add(const Reference& reference) {
    for (int axis = 0; axis < 3; ++axis) {
      const double centre = reference.bounds.DoubledCentre(axis);
      min[axis] = std::min(min[axis], centre);
      max[axis] = std::max(max[axis], centre);
    }
  }
  void Merge(const CentreRange& other) {
    for (int axis = 0; axis < 3; ++axis) {
      min[axis] = std::min(min[axis], other.min[axis]);
      max[axis] = std::max(max[axis], other.max[axis]);
    }
  }
};

struct Bin {
  Bounds bounds;
  uint32_t count = 0;
  double min_centre = kInfinity;

  void Merge(const Bin& other) {
    bounds.Extend(other.bounds);
    count += other.count;
    min_centre = std::min(min_centre, other.min_centre);
  }
};

struct Bins {
  std::array<std::array<Bin, kBins>, 3> bins;
  std::array<double, 3> first;  // the least centre
  std::array<double, 3> scale;  // bins per unit

  explicit Bins(const CentreRange& range) : first(range.min) {
    for (int axis = 0; axis < 3; ++axis) {
      const double extent = range.max[axis] - range.min[axis];
      scale[axis] = extent > 0 ? kBins / extent : 0;
    }
  }
  void Add(const Reference& reference) {
    for (int axis = 0; axis < 3; ++axis) {
      const double centre = reference.bounds.DoubledCentre(axis);
      const int index = static_cast<int>((centre - first[axis]) * scale[axis]);
      Bin& bin = bins[axis][std::min(index, kBins - 1)];
      bin.bounds.Extend(reference.bounds);
      ++bin.count;
      bin.min_centre = std::min(bin.min_centre, centre);
    }
  }
  void Merge(const Bins& other) {
    for (int axis = 0; axis < 3; ++axis) {
      for (int i = 0; i < kBins; ++i) bins[axis][i].Merge(other.bins[axis][i]);
    }
  }
};

ObjectSplit CheapestBoundary(const Bins& bins) {
  ObjectSplit best;
  for (int axis = 0; axis < 3; ++axis) {
    // rights[i]: all bins from i on.
    std::array<Bin, kBins + 1> rights;
    for (int i = kBins - 1; i > 0; --i) {
      rights[i] = rights[i + 1];
      rights[i].Merge(bins.bins[axis][i]);
    }
    Bin left;
    for (int i = 1; i < kBins; ++i) {
      left.Merge(bins.bins[axis][i - 1]);
      const Bin& right = rights[i];
      if (left.count == 0 || right.count == 0) continue;
      const double cost = left.bounds.HalfArea() * left.count + right.bounds.HalfArea() * right.count;
      if (cost < best.cost) best = {cost, axis, {right.min_centre, 0}, left.bounds, right.bounds};
    }
  }
  return best;
}

}  // namespace

ObjectSplit FindObjectSplit(std::span<const Reference> references, BuildContext& context) {
  if (references.size() <= kSweepReferences) return SweepObjectSplit(references);
  const CentreRange range = ReduceReferences(references, CentreRange(), context);
  return CheapestBoundary(ReduceReferences(references, Bins(range), context));
}

ObjectSplit SweepObjectSplit(std::span<const Reference> references) {
  const size_t count = references.size();
  struct Item {
    SplitKey key;
    uint32_t index;
  };
  std::vector<Item> items(count);
  std::vector<double> right_areas(count);
  ObjectSplit best;
  size_t best_imbalance = 0;
  for (int axis = 0; axis < 3; ++axis) {
    for (uint32_t i = 0; i < count; ++i) items[i] = {SplitKey(references[i], axis), i};
    std::sort(items.begin(), items.end(), [](const Item& a, const Item& b) { return a.key < b.key; });
    Bounds right;
    for (size_t i = count; i-- > 1;) {
      right.Extend(references[items[i].index].bounds);
      right_areas[i] = right.HalfArea();
    }
    Bounds left;
    for (size_t i = 1; i < count; ++i) {
      left.Extend(references[items[i - 1].index].bounds);
      const double cost = left.HalfArea() * static_cast<double>(i) + right_areas[i] * static_cast<double>(count - i);
      // Copies of a triangle cost the same wherever they are split; halves keep the tree flat.
      const size_t imbalance = std::max(i, count - i);
      if (cost > best.cost || (cost == best.cost && imbalance >= best_imbalance)) continue;
      best.cost = cost;
      best.axis = axis;
      best.first_right = items[i].key;
      best_imbalance = imbalance;
    }
  }
  if (best.IsFound()) {
    for (const Reference& reference : references) {
      (best.GoesLeft(reference) ? best.left : best.right).Extend(reference.bounds);
    }
  }
  return best;
}

ObjectSplit MedianSplit(std::span<Reference> references, const Bounds& bounds) {
  ObjectSplit split;
  split.axis = bounds.WidestAxis();
  const auto middle = references.begin() + references.size() / 2;
  std::nth_element(references.begin(), middle, references.end(), [&](const Reference& a, const Reference& b) {
    return SplitKey(a, split.axis) < SplitKey(b, split.axis);
  });
  split.first_right = SplitKey(*middle, split.axis);
  for (auto i = references.begin(); i != middle; ++i) split.left.Extend(i->bounds);
  for (auto i = middle; i != references.end(); ++i) split.right.Extend(i->bounds);
  split.cost = split.left.HalfArea() * static_cast<double>(middle - references.begin()) +
               split.right.HalfArea() * static_cast<double>(references.end() - middle);
  return split;
}

size_t Partition(std::span<Reference> references, const ObjectSplit& split, const BuildContext& context) {
  const auto goes_left = [&](const Reference& r) { return context.cancelled() || split.GoesLeft(r); };
  return std::partition(references.begin(), references.end(), goes_left) - references.begin();
}

}  // namespace deltaray
