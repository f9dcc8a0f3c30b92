// Sums over references, in parallel where there are many.

#ifndef SERVER_BUILD_REDUCE_REFERENCES_H_
#define SERVER_BUILD_REDUCE_REFERENCES_H_

#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <cstddef>
#include <span>

#include "server/build/build_context.h"
#include "server/build/reference.h"

namespace deltaray {

// Adds each reference to a T by T::Add(const Reference&); parts are put together by T::Merge(const T&), in order. The
// result does not depend on threads where Merge is associative. Anything where the build is cancelled.
template <typename T>
T ReduceReferences(std::span<const Reference> references, const T& zero, BuildContext& context) {
  constexpr size_t kGrain = 8192;
  const auto add = [&](std::span<const Reference> part, T sum) {
    for (const Reference& reference : part) sum.Add(reference);
    return sum;
  };
  if (references.size() <= kGrain) return add(references, zero);
  return tbb::parallel_reduce(
      tbb::blocked_range<size_t>(0, references.size(), kGrain), zero,
      [&](const tbb::blocked_range<size_t>& range, T sum) {
        if (context.cancelled()) return sum;
        const BuildContext::CpuTime time(context);
        return add(references.subspan(range.begin(), range.size()), sum);
      },
      [](T left, const T& right) {
        left.Merge(right);
        return left;
      });
}

}  // namespace deltaray

#endif  // SERVER_BUILD_REDUCE_REFERENCES_H_
