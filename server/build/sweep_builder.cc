#include "server/build/sweep_builder.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <limits>
#include <utility>

#include "absl/container/inlined_vector.h"
#include "server/build/point_bins.h"
#include "server/build/reduce_references.h"
#include "server/build/top_down.h"

namespace deltaray {
namespace {

// No allocation for δ-leaves of the usual size.
template <typename T>
using Array = absl::InlinedVector<T, 64>;

// Puts `keys`, no two of which are the same, in order.
void Sort(std::span<const int32_t> keys, std::span<int32_t> sorted) {
  const size_t count = keys.size();
  if (count > 64) {
    std::copy(keys.begin(), keys.end(), sorted.begin());
    std::sort(sorted.begin(), sorted.end());
    return;
  }
  // How many are less is where one stands. This is done in vector registers and does not branch; few are sorted so in a
  // fifth of the time.
  for (const int32_t key : keys) {
    int32_t less = 0;
    for (size_t i = 0; i < count; ++i) less += keys[i] < key;
    sorted[less] = key;
  }
}

class SweepBuilder {
 public:
  SweepBuilder(std::span<const Reference> references, const SahCosts& costs, const BuildContext& context)
      : context_(context),
        work_(references.size() + 1),
        right_costs_(references.size()),
        moved_(references.size()),
        is_left_(references.size()) {
    const size_t count = references.size();
    boxes_.reserve(count);
    for (const Reference& reference : references) boxes_.push_back(reference.packed_bounds());
    for (uint32_t i = 0; i <= count; ++i) work_[i] = static_cast<float>(costs.Work(i));
    // Sorted once, by places of centres within the box with indices in the low bits; splits keep the order of each
    // side.
    BoundsSum sum;
    sum.Add(references);
    const int index_bits = std::bit_width(count - 1);
    const PointBins places(sum.half_centres, 1 << std::min(31 - index_bits, 24));  // float has 24 bits
    std::array<Array<int32_t>, 3> keys{Array<int32_t>(count), Array<int32_t>(count), Array<int32_t>(count)};
    for (uint32_t i = 0; i < count; ++i) {
      const PackedInts place = places.At(boxes_[i].HalfCentre());
      for (int axis = 0; axis < 3; ++axis) keys[axis][i] = place[axis] << index_bits | static_cast<int32_t>(i);
    }
    Array<int32_t> sorted(count);
    const uint32_t index_mask = (1u << index_bits) - 1;
    for (int axis = 0; axis < 3; ++axis) {
      Sort(std::span<const int32_t>(keys[axis].data(), count), std::span<int32_t>(sorted.data(), count));
      orders_[axis].resize(count);
      for (uint32_t i = 0; i < count; ++i) orders_[axis][i] = static_cast<uint32_t>(sorted[i]) & index_mask;
    }
    dendrogram_.reserve(count - 1);
  }

  Dendrogram Build() {
    Split(0, static_cast<uint32_t>(boxes_.size()), 0);
    return std::move(dendrogram_);
  }

 private:
  // The first ones along an axis go left.
  struct Sweep {
    int axis = 0;
    uint32_t left_count = 0;
  };

  // Returns the cluster of all references that stand from `begin` to `end` in the orders.
  uint32_t Split(uint32_t begin, uint32_t end, uint32_t depth) {
    if (end - begin == 1 || context_.cancelled()) return orders_[0][begin];
    if (end - begin == 2) return Add(orders_[0][begin], orders_[0][begin + 1]);
    PackedBounds bounds;
    for (uint32_t i = begin; i < end; ++i) bounds.Extend(boxes_[orders_[0][i]]);
    const Bounds box = static_cast<Bounds>(bounds);
    const Sweep sweep = depth < kSahDepth ? CheapestSweep(begin, end, box) : Sweep{box.WidestAxis(), (end - begin) / 2};
    Part(begin, end, sweep);
    const uint32_t middle = begin + sweep.left_count;
    const uint32_t left = Split(begin, middle, depth + 1);
    const uint32_t right = Split(middle, end, depth + 1);
    return Add(left, right);
  }

  uint32_t Add(uint32_t left, uint32_t right) {
    dendrogram_.push_back({left, right});
    return static_cast<uint32_t>(boxes_.size() + dendrogram_.size() - 1);
  }

  Sweep CheapestSweep(uint32_t begin, uint32_t end, const Bounds& bounds) {
    const uint32_t count = end - begin;
    // Halves, where nothing can be told.
    Sweep best{bounds.WidestAxis(), count / 2};
    const float scale = UnitScale(bounds);
    float least = std::numeric_limits<float>::infinity();
    uint32_t least_imbalance = 0;
    for (int axis = 0; axis < 3; ++axis) {
      const uint32_t* const order = &orders_[axis][begin];
      PackedBounds right;
      for (uint32_t i = count; i-- > 1;) {
        right.Extend(boxes_[order[i]]);
        right_costs_[i] = right.HalfArea(scale) * work_[count - i];
      }
      PackedBounds left;
      for (uint32_t i = 1; i < count; ++i) {
        left.Extend(boxes_[order[i - 1]]);
        const float cost = left.HalfArea(scale) * work_[i] + right_costs_[i];
        // Copies of a triangle cost the same wherever they are split; halves keep the tree flat.
        const uint32_t imbalance = std::max(i, count - i);
        if (cost > least || (cost == least && imbalance >= least_imbalance)) continue;
        least = cost;
        least_imbalance = imbalance;
        best = {axis, i};
      }
    }
    return best;
  }

  // Puts the left ones before the right ones in all three orders.
  void Part(uint32_t begin, uint32_t end, const Sweep& sweep) {
    for (uint32_t i = begin; i < end; ++i) is_left_[orders_[sweep.axis][i]] = i - begin < sweep.left_count;
    for (int axis = 0; axis < 3; ++axis) {
      if (axis == sweep.axis) continue;
      uint32_t* const order = orders_[axis].data();
      uint32_t left = begin, right = 0;
      // Without a branch on the side, which no predictor guesses.
      for (uint32_t i = begin; i < end; ++i) {
        const uint32_t reference = order[i];
        const bool is_left = is_left_[reference];
        order[left] = reference;
        moved_[right] = reference;
        left += is_left;
        right += !is_left;
      }
      std::copy_n(moved_.begin(), right, order + left);
    }
  }

  const BuildContext& context_;
  Array<PackedBounds> boxes_;
  std::array<Array<uint32_t>, 3> orders_;  // references by centre along each axis
  Array<float> work_;                      // of so many references
  Array<float> right_costs_;
  Array<uint32_t> moved_;
  Array<uint8_t> is_left_;  // by reference
  Dendrogram dendrogram_;
};

}  // namespace

Dendrogram SplitBySweeps(std::span<const Reference> references, const SahCosts& costs, const BuildContext& context) {
  return SweepBuilder(references, costs, context).Build();
}

}  // namespace deltaray
