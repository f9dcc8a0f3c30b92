#include "server/build/morton_order.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <memory>
#include <utility>

#include "server/build/point_bins.h"
#include "server/build/reduce_references.h"

namespace deltaray {
namespace {

// A key is a place on the curve above an index, so that one number holds both and no two are the same.
constexpr int kAxisBits = 11;
constexpr int kIndexBits = 31;
static_assert(3 * kAxisBits + kIndexBits == 64);

constexpr int kDigitBits = 11;
constexpr size_t kDigits = size_t{1} << kDigitBits;
constexpr size_t kBlock = 32768;

// Puts two zeros after each of the low 11 bits.
uint64_t Spread(int x) {
  uint32_t bits = static_cast<uint32_t>(x);
  bits = (bits | bits << 16) & 0x0700'00FF;
  bits = (bits | bits << 8) & 0x0700'F00F;
  bits = (bits | bits << 4) & 0x430C'30C3;
  return (bits | bits << 2) & 0x4924'9249;
}

// Calls work(block, begin, end) for each block of `count` elements, in parallel.
template <typename Work>
void ForEachBlock(size_t count, BuildContext& context, const Work& work) {
  tbb::parallel_for(tbb::blocked_range<size_t>(0, (count + kBlock - 1) / kBlock, 1),
                    [&](const tbb::blocked_range<size_t>& range) {
                      const BuildContext::CpuTime time(context);
                      for (size_t block = range.begin(); block < range.end() && !context.cancelled(); ++block) {
                        work(block, block * kBlock, std::min((block + 1) * kBlock, count));
                      }
                    });
}

// Bins of cubes, so that the curve does not prefer an axis along which there is little.
PointBins Cubes(const PackedBounds& centres) {
  float longest = 0;
  for (int axis = 0; axis < 3; ++axis) longest = std::max(longest, centres.max[axis] - centres.min[axis]);
  PackedBounds cube = centres;
  cube.max = centres.min + PackedFloats{longest, longest, longest, 0};
  return PointBins(cube, 1 << kAxisBits);
}

// Sorts `keys` by the digit above `shift` into `sorted`; the same digits stay in order.
void SortByDigit(std::span<const uint64_t> keys, int shift, uint64_t* sorted, BuildContext& context) {
  // 1. How often each digit is in each block.
  std::vector<std::array<uint32_t, kDigits>> places((keys.size() + kBlock - 1) / kBlock);
  const auto digit = [shift](uint64_t key) { return key >> shift & (kDigits - 1); };
  ForEachBlock(keys.size(), context, [&](size_t block, size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) ++places[block][digit(keys[i])];
  });

  // 2. Where each block puts its first one of each digit.
  uint32_t next = 0;
  for (size_t d = 0; d < kDigits; ++d) {
    for (auto& block : places) next += std::exchange(block[d], next);
  }

  // 3. Put them there.
  if (context.cancelled()) return;
  ForEachBlock(keys.size(), context, [&](size_t block, size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) sorted[places[block][digit(keys[i])]++] = keys[i];
  });
}

}  // namespace

std::vector<uint32_t> MortonOrder(std::span<const Reference> references, BuildContext& context) {
  const size_t count = references.size();
  const BoundsSum sum = SumBounds(references, context);
  if (context.cancelled()) return {};
  const PointBins cubes = Cubes(sum.half_centres);
  const auto keys = std::make_unique_for_overwrite<uint64_t[]>(count);
  const auto sorted = std::make_unique_for_overwrite<uint64_t[]>(count);
  const int64_t bytes = static_cast<int64_t>(2 * count * sizeof(uint64_t));
  context.CountBytes(bytes);
  ForEachBlock(count, context, [&](size_t, size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) {
      const PackedInts cube = cubes.At(references[i].packed_bounds().HalfCentre());
      keys[i] = (Spread(cube[0]) | Spread(cube[1]) << 1 | Spread(cube[2]) << 2) << kIndexBits | i;
    }
  });
  SortByDigit({keys.get(), count}, kIndexBits, sorted.get(), context);
  SortByDigit({sorted.get(), count}, kIndexBits + kDigitBits, keys.get(), context);
  SortByDigit({keys.get(), count}, kIndexBits + 2 * kDigitBits, sorted.get(), context);

  std::vector<uint32_t> order(count);
  ForEachBlock(count, context, [&](size_t, size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) order[i] = static_cast<uint32_t>(sorted[i] & ((1u << kIndexBits) - 1));
  });
  context.CountBytes(-bytes);
  return order;
}

}  // namespace deltaray
