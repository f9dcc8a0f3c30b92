#include "server/build/spatial_split.h"

#include <algorithm>
#include <array>
#include <utility>

#include "server/build/reduce_references.h"
#include "server/geometry/clip_triangle.h"

namespace deltaray {
namespace {

constexpr int kBins = 16;

// The planes between the bins of one axis: bin i lies between planes[i] and planes[i + 1].
struct Planes {
  std::array<float, kBins + 1> planes;
  double bins_per_unit;

  Planes(const Bounds& bounds, int axis) {
    const double min = bounds.min[axis], extent = static_cast<double>(bounds.max[axis]) - min;
    for (int i = 0; i < kBins; ++i) planes[i] = static_cast<float>(min + extent * i / kBins);
    planes[kBins] = bounds.max[axis];
    bins_per_unit = extent > 0 ? kBins / extent : 0;
  }

  // The last bin that begins at or before `x`, where x is within the bounds.
  int BinAt(float x) const {
    int bin = std::clamp(static_cast<int>((static_cast<double>(x) - planes[0]) * bins_per_unit), 0, kBins - 1);
    while (bin > 0 && planes[bin] > x) --bin;
    while (bin < kBins - 1 && planes[bin + 1] <= x) ++bin;
    return bin;
  }
  // The last bin that begins before `x`.
  int BinBefore(float x) const {
    int bin = BinAt(x);
    while (bin > 0 && planes[bin] >= x) --bin;
    return bin;
  }
};

// A reference enters the bin of its least coordinate and leaves in that of its greatest; one that only touches a plane
// is on one side of it, as in Side below.
struct SpatialBin {
  Bounds bounds;  // of the parts in the bin
  uint32_t entered = 0;
  uint32_t left = 0;
};

// Adds the parts of a reference in bins `first` to `last` to them. What this makes is an estimate: the triangle is cut
// at the planes alone, not to its cell, and rounding is not looked at, since only the choice of a plane depends on it.
void AddParts(const Reference& reference, const Triangle& triangle, const Planes& planes, int axis, int first, int last,
              std::array<SpatialBin, kBins>& bins) {
  std::array<Bounds, kBins> parts;
  const Vec3f corners[] = {triangle.v0, triangle.v1, triangle.v2};
  for (int i = 0; i < 3; ++i) {
    const Vec3f& corner = corners[i];
    if (corner[axis] >= planes.planes[first] && corner[axis] <= planes.planes[last + 1]) {
      parts[std::min(planes.BinAt(corner[axis]), last)].Extend(corner);
    }
    const Vec3f& next = corners[i == 2 ? 0 : i + 1];
    const Vec3f& a = corner[axis] <= next[axis] ? corner : next;
    const Vec3f& b = corner[axis] <= next[axis] ? next : corner;
    const Vec3f along = (1 / (b[axis] - a[axis])) * (b - a);
    for (int plane = first; plane <= last + 1 && planes.planes[plane] < b[axis]; ++plane) {
      const float position = planes.planes[plane];
      if (position < a[axis]) continue;
      const Vec3f point = a + (position - a[axis]) * along;
      if (plane > first) parts[plane - 1].Extend(point);
      if (plane <= last) parts[plane].Extend(point);
    }
  }
  for (int bin = first; bin <= last; ++bin) bins[bin].bounds.Extend(Intersection(parts[bin], reference.bounds));
}

struct SpatialBins {
  const TrianglesView* triangles;
  const std::array<Planes, 3>* planes;
  std::array<std::array<SpatialBin, kBins>, 3> bins;

  void Add(const Reference& reference) {
    const Triangle triangle = (*triangles)[reference.primitive];
    for (int axis = 0; axis < 3; ++axis) {
      const Planes& axis_planes = (*planes)[axis];
      const int last = axis_planes.BinBefore(reference.bounds.max[axis]);
      const int first = std::min(last, axis_planes.BinAt(reference.bounds.min[axis]));
      ++bins[axis][first].entered;
      ++bins[axis][last].left;
      if (first == last) {
        bins[axis][first].bounds.Extend(reference.bounds);
      } else {
        AddParts(reference, triangle, axis_planes, axis, first, last, bins[axis]);
      }
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
  if (reference.bounds.max[split.axis] <= split.position) return Side::kLeft;
  if (reference.bounds.min[split.axis] >= split.position) return Side::kRight;
  return Side::kBoth;
}

}  // namespace

SpatialSplit FindSpatialSplit(std::span<const Reference> references, const TrianglesView& triangles,
                              const Bounds& bounds, size_t room, BuildContext& context) {
  const std::array<Planes, 3> planes{Planes(bounds, 0), Planes(bounds, 1), Planes(bounds, 2)};
  const SpatialBins sum = ReduceReferences(references, SpatialBins{&triangles, &planes, {}}, context);

  SpatialSplit best;
  for (int axis = 0; axis < 3; ++axis) {
    const auto& bins = sum.bins[axis];
    std::array<double, kBins> right_areas;
    Bounds right;
    for (int i = kBins - 1; i > 0; --i) {
      right.Extend(bins[i].bounds);
      right_areas[i] = right.HalfArea();
    }
    Bounds left;
    size_t left_count = 0, right_count = references.size();
    for (int i = 1; i < kBins; ++i) {
      left.Extend(bins[i - 1].bounds);
      left_count += bins[i - 1].entered;
      right_count -= bins[i - 1].left;
      // Each child is to be smaller than its parent, else this may never end.
      if (left_count >= references.size() || right_count >= references.size()) continue;
      if (left_count + right_count - references.size() > room) continue;
      const double cost =
          left.HalfArea() * static_cast<double>(left_count) + right_areas[i] * static_cast<double>(right_count);
      if (cost < best.cost) best = {cost, axis, planes[axis].planes[i]};
    }
  }
  return best;
}

SpatialParts Partition(std::span<Reference> references, size_t count, const TrianglesView& triangles,
                       const SpatialSplit& split, const BuildContext& context) {
  // 1. Those on one side only go to the front and to the back.
  const auto begin = references.begin();
  const auto cut_begin = std::partition(begin, begin + count, [&](const Reference& reference) {
    return context.cancelled() || SideOf(reference, split) == Side::kLeft;
  });
  const auto cut_end = std::partition(cut_begin, begin + count, [&](const Reference& reference) {
    return context.cancelled() || SideOf(reference, split) == Side::kBoth;
  });
  SpatialParts parts;
  for (auto i = begin; i != cut_begin && !context.cancelled(); ++i) parts.left.Extend(i->bounds);
  for (auto i = cut_end; i != begin + count && !context.cancelled(); ++i) parts.right.Extend(i->bounds);

  // 2. Those that the plane cuts go where it is cheapest.
  double left_count = static_cast<double>(cut_end - begin),
         right_count = static_cast<double>(begin + count - cut_begin);
  auto cut = cut_begin, right_begin = cut_end, end = begin + count;
  while (cut != right_begin && !context.cancelled()) {
    Bounds left_part, right_part;
    SplitTriangle(triangles[cut->primitive], split.axis, split.position, cut->bounds, &left_part, &right_part);
    const Bounds split_left = Union(parts.left, left_part), split_right = Union(parts.right, right_part);
    const Bounds whole_left = Union(parts.left, cut->bounds), whole_right = Union(parts.right, cut->bounds);
    const double cost_split = split_left.HalfArea() * left_count + split_right.HalfArea() * right_count;
    const double cost_left = whole_left.HalfArea() * left_count + parts.right.HalfArea() * (right_count - 1);
    const double cost_right = parts.left.HalfArea() * (left_count - 1) + whole_right.HalfArea() * right_count;
    if (right_part.IsEmpty() || (!left_part.IsEmpty() && cost_left < cost_split && cost_left <= cost_right)) {
      parts.left = whole_left;
      --right_count;
      ++cut;
    } else if (left_part.IsEmpty() || cost_right < cost_split) {
      parts.right = whole_right;
      --left_count;
      std::swap(*cut, *--right_begin);
    } else {
      parts.left = split_left;
      parts.right = split_right;
      *end++ = {right_part, cut->primitive};
      cut->bounds = left_part;
      ++cut;
    }
  }
  parts.left_count = right_begin - begin;
  parts.right_count = end - right_begin;
  return parts;
}

}  // namespace deltaray
