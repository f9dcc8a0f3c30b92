// Sums over references, in parallel where there are many.

#ifndef SERVER_BUILD_REDUCE_REFERENCES_H_
#define SERVER_BUILD_REDUCE_REFERENCES_H_

#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <cstddef>
#include <span>

#include "server/build/build_context.h"
#include "server/build/reference.h"
#include "server/geometry/packed_bounds.h"

namespace deltaray {

// Adds references to `sum` by T::Add(std::span<const Reference>); parts begin as copies of what `sum` is at first and
// are put together by T::Merge(const T&), in order. The result does not depend on threads where Merge is associative
// and adding a copy of the first value changes nothing. Anything where the build is cancelled.
template <typename T>
void ReduceReferences(std::span<const Reference> references, T* sum, BuildContext& context) {
  constexpr size_t kGrain = 8192;
  if (references.size() <= kGrain) return sum->Add(references);
  *sum = tbb::parallel_reduce(
      tbb::blocked_range<size_t>(0, references.size(), kGrain), *sum,
      [&](const tbb::blocked_range<size_t>& range, T part_sum) {
        if (context.cancelled()) return part_sum;
        const BuildContext::CpuTime time(context);
        part_sum.Add(references.subspan(range.begin(), range.size()));
        return part_sum;
      },
      [](T left, const T& right) {
        left.Merge(right);
        return left;
      });
}

// The box of some references, and that of the halves of their boxes' centres.
struct BoundsSum {
  PackedBounds bounds;
  PackedBounds half_centres;

  void Add(std::span<const Reference> references) {
    for (const Reference& reference : references) {
      const PackedBounds packed = reference.packed_bounds();
      bounds.Extend(packed);
      half_centres.Extend(packed.HalfCentre());
    }
  }
  void Merge(const BoundsSum& other) {
    bounds.Extend(other.bounds);
    half_centres.Extend(other.half_centres);
  }
};

inline BoundsSum SumBounds(std::span<const Reference> references, BuildContext& context) {
  BoundsSum sum;
  ReduceReferences(references, &sum, context);
  return sum;
}

}  // namespace deltaray

#endif  // SERVER_BUILD_REDUCE_REFERENCES_H_
