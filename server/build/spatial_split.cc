#include "server/build/spatial_split.h"

#include <algorithm>
#include <array>
#include <utility>

#include "server/build/partition.h"
#include "server/build/reduce_references.h"
#include "server/geometry/clip_triangle.h"
#include "server/geometry/packed_bounds.h"

namespace deltaray {
namespace {

constexpr int kBins = 16;
// Planes across an axis in which a node is narrower than this part of its greatest width were measured to gain nothing.
constexpr double kLeastWidth = 0.5;

// The plane below bin `i`.
float Position(const Bounds& bounds, int axis, int i) {
  const double min = bounds.min[axis], max = bounds.max[axis];
  return static_cast<float>(min + (max - min) * i / kBins);
}

// `bounds` without width along the axes that are not to be cut.
PackedBounds WideAxes(const Bounds& bounds) {
  const auto width = [&](int axis) { return static_cast<double>(bounds.max[axis]) - bounds.min[axis]; };
  PackedBounds wide(bounds);
  for (int axis = 0; axis < 3; ++axis) {
    if (width(axis) < kLeastWidth * width(bounds.WidestAxis())) wide.max[axis] = wide.min[axis];
  }
  return wide;
}

// The first and the last bin that a reference is in.
struct BinRange {
  PackedInts first, last;

  BinRange(const PointBins& bins, const PackedBounds& box) : first(bins.At(box.min)), last(bins.Before(box.max)) {
    last = last < first ? first : last;
  }
};

// A reference enters the bin of its least coordinate and leaves in that of its greatest.
struct SpatialBin {
  PackedBounds bounds;  // of the parts in the bin
  uint32_t entered = 0;
  uint32_t left = 0;
};

// Where planes across an axis cut a triangle: its corners in order along the axis, and what its edges gain per unit.
class CutTriangle {
 public:
  CutTriangle(const Triangle& triangle, int axis) : axis_(axis) {
    const Vec3f* corners[] = {&triangle.v0, &triangle.v1, &triangle.v2};
    if ((*corners[0])[axis] > (*corners[1])[axis]) std::swap(corners[0], corners[1]);
    if ((*corners[1])[axis] > (*corners[2])[axis]) std::swap(corners[1], corners[2]);
    if ((*corners[0])[axis] > (*corners[1])[axis]) std::swap(corners[0], corners[1]);
    for (int i = 0; i < 3; ++i) corners_[i] = Pack(*corners[i]);
    long_edge_ = Slope(corners_[0], corners_[2]);
    first_edge_ = Slope(corners_[0], corners_[1]);
    second_edge_ = Slope(corners_[1], corners_[2]);
  }

  // Extends `part` by what the plane at `position`, or else the nearest corner, has of the triangle.
  void ExtendByCut(float position, PackedBounds* part) const {
    const float x = std::clamp(position, corners_[0][axis_], corners_[2][axis_]);
    const bool in_first = x < corners_[1][axis_];
    const int from = in_first ? 0 : 1;
    part->Extend(corners_[0] + (x - corners_[0][axis_]) * long_edge_);
    part->Extend(corners_[from] + (x - corners_[from][axis_]) * (in_first ? first_edge_ : second_edge_));
  }
  // Extends `part` by the middle corner where that lies in [least, greatest].
  void ExtendByCorner(float least, float greatest, PackedBounds* part) const {
    if (corners_[1][axis_] >= least && corners_[1][axis_] <= greatest) part->Extend(corners_[1]);
  }

 private:
  PackedFloats Slope(PackedFloats a, PackedFloats b) const {
    const float length = b[axis_] - a[axis_];
    return length > 0 ? (1 / length) * (b - a) : PackedFloats{};
  }

  int axis_;
  std::array<PackedFloats, 3> corners_;
  PackedFloats long_edge_, first_edge_, second_edge_;
};

struct SpatialBins {
  const TrianglesView* triangles;
  const PointBins* points;
  const std::array<std::array<float, kBins>, 3>* planes;
  std::array<std::array<SpatialBin, kBins>, 3> bins;

  void Add(std::span<const Reference> references) {
    for (const Reference& reference : references) Add(reference);
  }

  void Add(const Reference& reference) {
    const PackedBounds packed = reference.packed_bounds();
    const BinRange range(*points, packed);
    for (int axis = 0; axis < 3; ++axis) {
      if (!points->CanCut(axis)) continue;
      const int first = range.first[axis], last = range.last[axis];
      ++bins[axis][first].entered;
      ++bins[axis][last].left;
      if (first == last) {
        bins[axis][first].bounds.Extend(packed);
      } else if (first + 1 == last) {
        // The box cut in two is close to the triangle cut in two, and saves the way to the triangle.
        PackedBounds low = packed, high = packed;
        low.max[axis] = high.min[axis] = (*planes)[axis][last];
        bins[axis][first].bounds.Extend(low);
        bins[axis][last].bounds.Extend(high);
      } else {
        AddParts(reference, packed, axis, first, last);
      }
    }
  }

  // Adds the parts of a reference in bins `first` to `last` to them. What this makes is an estimate: rounding is not
  // looked at, since only the choice of a plane depends on it.
  void AddParts(const Reference& reference, const PackedBounds& packed, int axis, int first, int last) {
    const CutTriangle triangle((*triangles)[reference.primitive], axis);
    float position = packed.min[axis];
    PackedBounds cut;
    triangle.ExtendByCut(position, &cut);
    for (int bin = first; bin <= last; ++bin) {
      PackedBounds part = cut;
      const float next = bin == last ? packed.max[axis] : (*planes)[axis][bin + 1];
      cut = PackedBounds();
      triangle.ExtendByCut(next, &cut);
      part.Extend(cut);
      triangle.ExtendByCorner(position, next, &part);
      bins[axis][bin].bounds.Extend({Greatest(part.min, packed.min), Least(part.max, packed.max)});
      position = next;
    }
  }

  void Merge(const SpatialBins& other) {
    for (int axis = 0; axis < 3; ++axis) {
      for (int i = 0; i < kBins; ++i) {
        bins[axis][i].bounds.Extend(other.bins[axis][i].bounds);
        bins[axis][i].entered += other.bins[axis][i].entered;
        bins[axis][i].left += other.bins[axis][i].left;
      }
    }
  }
};

enum class Side { kLeft, kRight, kBoth };

Side SideOf(const Reference& reference, const SpatialSplit& split) {
  const int first = split.bins.At(reference.bounds.min[split.axis], split.axis);
  if (first >= split.bin) return Side::kRight;
  const int last = split.bins.Before(reference.bounds.max[split.axis], split.axis);
  return std::max(first, last) < split.bin ? Side::kLeft : Side::kBoth;
}

// A side of a split while what the plane cuts is shared out.
struct Part {
  Bounds bounds;
  double count = 0;  // of those that are there and those that may come

  double Cost() const { return bounds.HalfArea() * count; }
  Part With(const Bounds& more) const { return {Union(bounds, more), count}; }
  Part WithoutOne() const { return {bounds, count - 1}; }
};

}  // namespace

SpatialSplit FindSpatialSplit(std::span<const Reference> references, const TrianglesView& triangles,
                              const Bounds& bounds, const SahCosts& costs, size_t room, BuildContext& context) {
  const PointBins points(WideAxes(bounds), kBins);
  std::array<std::array<float, kBins>, 3> planes;
  for (int axis = 0; axis < 3; ++axis) {
    for (int i = 0; i < kBins; ++i) planes[axis][i] = Position(bounds, axis, i);
  }
  SpatialBins sum{&triangles, &points, &planes, {}};
  ReduceReferences(references, &sum, context);
  const auto count = static_cast<uint32_t>(references.size());

  SpatialSplit best;
  for (int axis = 0; axis < 3; ++axis) {
    if (!points.CanCut(axis)) continue;
    const auto& bins = sum.bins[axis];
    std::array<double, kBins> right_areas;
    PackedBounds right;
    for (int i = kBins - 1; i > 0; --i) {
      right.Extend(bins[i].bounds);
      right_areas[i] = static_cast<Bounds>(right).HalfArea();
    }
    PackedBounds left;
    uint32_t left_count = 0, right_count = count;
    for (int i = 1; i < kBins; ++i) {
      left.Extend(bins[i - 1].bounds);
      left_count += bins[i - 1].entered;
      right_count -= bins[i - 1].left;
      // Each child is to be smaller than its parent, else this may never end.
      if (left_count >= count || right_count >= count) continue;
      if (left_count + right_count - count > room) continue;
      const double cost =
          static_cast<Bounds>(left).HalfArea() * costs.Work(left_count) + right_areas[i] * costs.Work(right_count);
      if (cost < best.cost) best = {cost, points, axis, i, planes[axis][i]};
    }
  }
  return best;
}

std::pair<size_t, size_t> Partition(std::span<Reference> references, size_t count, const TrianglesView& triangles,
                                    const SpatialSplit& split, BuildContext& context) {
  // 1. Those on one side only go to the front and to the back.
  const auto is_at_most = [&](Side side) {
    return [&split, side](const Reference& reference) {
      const Side of = SideOf(reference, split);
      return of == Side::kLeft || of == side;
    };
  };
  const std::span<Reference> all = references.first(count);
  const size_t cut_end = PartitionReferences(all, is_at_most(Side::kBoth), context);
  const size_t cut_begin = PartitionReferences(all.first(cut_end), is_at_most(Side::kLeft), context);
  const auto bounds_of = [&](std::span<const Reference> part) {
    return static_cast<Bounds>(SumBounds(part, context).bounds);
  };
  Part left{bounds_of(all.first(cut_begin)), static_cast<double>(cut_end)};
  Part right{bounds_of(all.subspan(cut_end)), static_cast<double>(count - cut_begin)};

  // 2. Those that the plane cuts go where it is cheapest. Neither side is left empty.
  size_t cut = cut_begin, right_begin = cut_end, end = count;
  while (cut != right_begin && !context.cancelled()) {
    Reference& reference = references[cut];
    Bounds left_box, right_box;
    SplitTriangle(triangles[reference.primitive], split.axis, split.position, reference.bounds, &left_box, &right_box);
    const bool has_two_parts = !left_box.IsEmpty() && !right_box.IsEmpty();
    const Part whole_left = left.With(reference.bounds), whole_right = right.With(reference.bounds);
    const double cost_left = whole_left.Cost() + right.WithoutOne().Cost();
    const double cost_right = left.WithoutOne().Cost() + whole_right.Cost();
    const double cost_split = left.With(left_box).Cost() + right.With(right_box).Cost();
    // There is room, but where another task of the build has thrown: sums are of a part then.
    if (has_two_parts && end < references.size() && cost_split <= std::min(cost_left, cost_right)) {
      left = left.With(left_box);
      right = right.With(right_box);
      references[end++] = {right_box, reference.primitive};
      reference.bounds = left_box;
      ++cut;
    } else if (left.count == 1 ||
               (right.count > 1 && (right_box.IsEmpty() || (!left_box.IsEmpty() && cost_left <= cost_right)))) {
      left = whole_left;
      right = right.WithoutOne();
      ++cut;
    } else {
      right = whole_right;
      left = left.WithoutOne();
      std::swap(reference, references[--right_begin]);
    }
  }
  return {right_begin, end - right_begin};
}

}  // namespace deltaray
