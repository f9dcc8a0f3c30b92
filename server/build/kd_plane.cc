#include "server/build/kd_plane.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace deltaray {
namespace {

// Nodes with more references look at kPlaneBins - 1 planes, others at every face of every box.
constexpr size_t kMaxExactReferences = 1024;
constexpr int kPlaneBins = 64;

// What planes across one axis of a cell cost.
class PlaneCost {
 public:
  PlaneCost(const SahCosts& costs, const Bounds& cell, int axis, double empty_space_bonus)
      : costs_(costs),
        axis_(axis),
        empty_factor_(1 - empty_space_bonus),
        min_(cell.min[axis]),
        max_(cell.max[axis]),
        area_(cell.HalfArea()) {
    const Vec3d size = static_cast<Vec3d>(cell.max) - static_cast<Vec3d>(cell.min);
    const double a = size[(axis + 1) % 3], b = size[(axis + 2) % 3];
    cap_ = a * b;
    rim_ = a + b;
  }

  // Makes the plane `best` where it is cheaper: `left` and `right` references on its sides, `flat` ones in it. A plane
  // in a face of the cell would part nothing.
  void Consider(float position, size_t left, size_t flat, size_t right, KdPlane* best) const {
    if (position <= min_ || position >= max_) return;
    const double left_area = cap_ + rim_ * (position - min_), right_area = cap_ + rim_ * (max_ - position);
    const auto consider = [&](size_t l, size_t r, bool flat_left) {
      double cost = costs_.Split(area_, left_area * static_cast<double>(l) + right_area * static_cast<double>(r));
      if (l == 0 || r == 0) cost *= empty_factor_;
      if (cost < best->cost) *best = {cost, axis_, position, flat_left};
    };
    consider(left + flat, right, true);
    if (flat != 0) consider(left, right + flat, false);
  }

 private:
  SahCosts costs_;
  int axis_;
  double empty_factor_;
  double min_, max_, area_;
  double cap_, rim_;  // half area of a slice of the cell: cap_ + rim_ * thickness
};

// The best of all planes through faces of boxes across one axis. [Wald and Havran 2006], section 4.2.
KdPlane SweepPlanes(std::span<const Reference> references, const PlaneCost& cost, int axis) {
  enum Kind : uint8_t { kEnd, kFlat, kBegin };
  struct Event {
    float position;
    Kind kind;
    bool operator<(const Event& e) const { return position != e.position ? position < e.position : kind < e.kind; }
  };
  std::vector<Event> events;
  events.reserve(2 * references.size());
  for (const Reference& reference : references) {
    const float min = reference.bounds.min[axis], max = reference.bounds.max[axis];
    if (min == max) {
      events.push_back({min, kFlat});
    } else {
      events.push_back({min, kBegin});
      events.push_back({max, kEnd});
    }
  }
  std::sort(events.begin(), events.end());

  KdPlane best;
  size_t left = 0, right = references.size();
  for (auto event = events.begin(); event != events.end();) {
    const float position = event->position;
    std::array<size_t, 3> count{};
    for (; event != events.end() && event->position == position; ++event) ++count[event->kind];
    right -= count[kEnd] + count[kFlat];
    cost.Consider(position, left, count[kFlat], right, &best);
    left += count[kFlat] + count[kBegin];
  }
  return best;
}

// The best of planes at even distances across one axis.
KdPlane BinPlanes(std::span<const Reference> references, const PlaneCost& cost, const Bounds& cell, int axis) {
  const double min = cell.min[axis], width = (static_cast<double>(cell.max[axis]) - min) / kPlaneBins;
  if (width == 0) return {};
  // Clamped first: a reference's whole box may reach far beyond the cell.
  const auto bin = [&](float x) { return static_cast<int>(std::clamp((x - min) / width, 0.0, kPlaneBins - 1.0)); };
  std::array<size_t, kPlaneBins> begins{}, ends{};
  for (const Reference& reference : references) {
    ++begins[bin(reference.bounds.min[axis])];
    ++ends[bin(reference.bounds.max[axis])];
  }

  KdPlane best;
  size_t left = 0, right = references.size();
  for (int i = 1; i < kPlaneBins; ++i) {
    left += begins[i - 1];
    right -= ends[i - 1];
    cost.Consider(static_cast<float>(min + i * width), left, 0, right, &best);
  }
  return best;
}

}  // namespace

KdPlane FindKdPlane(std::span<const Reference> references, const Bounds& cell, int axis, const SahCosts& costs,
                    double empty_space_bonus) {
  const PlaneCost cost(costs, cell, axis, empty_space_bonus);
  return references.size() <= kMaxExactReferences ? SweepPlanes(references, cost, axis)
                                                  : BinPlanes(references, cost, cell, axis);
}

}  // namespace deltaray
