#include "server/build/object_split.h"

#include <algorithm>
#include <array>

// Compiled once for each kind of vector registers; HWY_NAMESPACE is another each time.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "server/build/object_split.cc"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "server/build/partition.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

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

class Bins {
 public:
  explicit Bins(const PointBins& points) : points_(points) {
    for (auto& along : boxes_) {
      for (Box& box : along) box = {kInfinity, kInfinity, kInfinity, kInfinity, kInfinity, kInfinity, 0, 0};
    }
  }

  const PointBins& points() const { return points_; }
  Bin bin(int axis, int i) const {
    const PackedBounds box = PackedBounds::Load(&boxes_[axis][i]);
    return {PackedBounds(box.min, -box.max), counts_[axis][i]};
  }

  HWY_ATTR void Add(std::span<const Reference> references) {
    for (const Reference& reference : references) {
      const PackedInts at = points_.At(reference.packed_bounds().HalfCentre());
      // A whole reference in one register where there is one so wide.
      for (size_t lane = 0; lane < kLanes; lane += hn::Lanes(kFloats)) {
        const auto floats = hn::LoadU(kFloats, reinterpret_cast<const float*>(&reference) + lane);
        const auto box = hn::Xor(hn::And(floats, BitsAt(kUsed, lane)), BitsAt(kNegated, lane));
        for (int axis = 0; axis < 3; ++axis) {
          float* const bin = &boxes_[axis][at[axis]][lane];
          hn::Store(hn::Min(box, hn::Load(kFloats, bin)), kFloats, bin);
        }
      }
      for (int axis = 0; axis < 3; ++axis) ++counts_[axis][at[axis]];
    }
  }

  HWY_ATTR void Merge(const Bins& other) {
    for (int axis = 0; axis < 3; ++axis) {
      for (int i = 0; i < kBins; ++i) {
        for (size_t lane = 0; lane < kLanes; ++lane) {
          boxes_[axis][i][lane] = std::min(boxes_[axis][i][lane], other.boxes_[axis][i][lane]);
        }
        counts_[axis][i] += other.counts_[axis][i];
      }
    }
  }

 private:
  // The floats of a Reference: least coordinates, greatest ones, which are negated so that all are united by Min, and
  // what is no coordinate.
  static constexpr size_t kLanes = sizeof(Reference) / sizeof(float);
  static constexpr float kInfinity = Bounds::kInfinity;
  static constexpr hn::CappedTag<float, kLanes> kFloats{};
  alignas(32) static constexpr uint32_t kUsed[kLanes] = {~0u, ~0u, ~0u, ~0u, ~0u, ~0u, 0, 0};
  alignas(32) static constexpr uint32_t kNegated[kLanes] = {0, 0, 0, 1u << 31, 1u << 31, 1u << 31, 0, 0};
  using Box = std::array<float, kLanes>;

  static HWY_ATTR hn::Vec<decltype(hn::CappedTag<float, kLanes>())> BitsAt(const uint32_t* bits, size_t lane) {
    const hn::RebindToUnsigned<hn::CappedTag<float, kLanes>> unsigned_lanes;
    return hn::BitCast(kFloats, hn::Load(unsigned_lanes, bits + lane));
  }

  PointBins points_;
  alignas(32) std::array<std::array<Box, kBins>, 3> boxes_;
  std::array<std::array<uint32_t, kBins>, 3> counts_{};
};

ObjectSplit FindSplit(std::span<const Reference> references, const BoundsSum& sum, const SahCosts& costs,
                      BuildContext& context) {
  Bins bins(PointBins(sum.half_centres, kBins));
  ReduceReferences(references, &bins, context);

  const float scale = UnitScale(static_cast<Bounds>(sum.bounds));
  float least = std::numeric_limits<float>::infinity();
  ObjectSplit best;
  Bin best_left, best_right;
  for (int axis = 0; axis < 3; ++axis) {
    if (!bins.points().CanCut(axis)) continue;
    // rights[i]: all bins from i on.
    std::array<Bin, kBins> rights;
    rights[kBins - 1] = bins.bin(axis, kBins - 1);
    for (int i = kBins - 2; i > 0; --i) {
      rights[i] = rights[i + 1];
      rights[i].Merge(bins.bin(axis, i));
    }
    Bin left;
    for (int i = 1; i < kBins; ++i) {
      left.Merge(bins.bin(axis, i - 1));
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
  best.bins = bins.points();
  best.left = static_cast<Bounds>(best_left.bounds);
  best.right = static_cast<Bounds>(best_right.bounds);
  best.cost = best.left.HalfArea() * costs.Work(best_left.count) + best.right.HalfArea() * costs.Work(best_right.count);
  return best;
}

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace deltaray {

HWY_EXPORT(FindSplit);

ObjectSplit FindObjectSplit(std::span<const Reference> references, const BoundsSum& sum, const SahCosts& costs,
                            BuildContext& context) {
  return HWY_DYNAMIC_DISPATCH(FindSplit)(references, sum, costs, context);
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
#endif  // HWY_ONCE
