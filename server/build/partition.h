// Sorts references to two sides, in parallel where there are many.

#ifndef SERVER_BUILD_PARTITION_H_
#define SERVER_BUILD_PARTITION_H_

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cstddef>
#include <span>
#include <utility>
#include <vector>

#include "server/build/build_context.h"
#include "server/build/reference.h"

namespace deltaray {

// Swaps every misplaced reference of `left_side` and `right_side`, which follow each other, with one of the other side.
// The misplaced ones are given as pieces in order of place; both sides have the same number of them.
class MisplacedReferences {
 public:
  // A piece of the array to which references of one side stand although the other side's belong there.
  void AddPiece(std::span<Reference> piece) {
    if (piece.empty()) return;
    pieces_.push_back({piece.data(), size_});
    size_ += piece.size();
  }
  size_t size() const { return size_; }

  // Swaps entries `begin` to `end` with those of `other`, counted over all pieces.
  void Swap(MisplacedReferences& other, size_t begin, size_t end) {
    size_t mine = PieceOf(begin), others = other.PieceOf(begin);
    for (size_t i = begin; i < end;) {
      const size_t stop = std::min({end, EndOf(mine), other.EndOf(others)});
      Reference* const first = pieces_[mine].first + (i - pieces_[mine].before);
      std::swap_ranges(first, first + (stop - i), other.pieces_[others].first + (i - other.pieces_[others].before));
      i = stop;
      if (i == EndOf(mine)) ++mine;
      if (i == other.EndOf(others)) ++others;
    }
  }

 private:
  struct Piece {
    Reference* first;
    size_t before;  // entries of earlier pieces
  };

  size_t PieceOf(size_t entry) const {
    const auto after = std::upper_bound(pieces_.begin(), pieces_.end(), entry,
                                        [](size_t value, const Piece& piece) { return value < piece.before; });
    return static_cast<size_t>(after - pieces_.begin()) - 1;
  }
  size_t EndOf(size_t piece) const { return piece + 1 < pieces_.size() ? pieces_[piece + 1].before : size_; }

  std::vector<Piece> pieces_;
  size_t size_ = 0;
};

// Puts those references for which `goes_left` holds before the others, and returns how many they are. Their order
// afterwards depends on the input alone, not on threads. Anything where the build is cancelled.
template <typename GoesLeft>
size_t PartitionReferences(std::span<Reference> references, const GoesLeft& goes_left, BuildContext& context) {
  // Without a branch on `goes_left`, which no predictor guesses: the next one always changes places with the first
  // right one, and then counts as left or not.
  const auto partition = [&](std::span<Reference> part) {
    size_t left = 0;
    for (Reference& reference : part) {
      const bool is_left = goes_left(reference);
      std::swap(reference, part[left]);
      left += is_left;
    }
    return left;
  };
  constexpr size_t kBlock = 16384;
  const size_t count = references.size();
  if (count <= 2 * kBlock) return partition(references);

  // 1. Each block by itself.
  const size_t blocks = (count + kBlock - 1) / kBlock;
  const auto block = [&](size_t i) { return references.subspan(i * kBlock, std::min(kBlock, count - i * kBlock)); };
  std::vector<size_t> left_counts(blocks);
  tbb::parallel_for(tbb::blocked_range<size_t>(0, blocks, 1), [&](const tbb::blocked_range<size_t>& range) {
    const BuildContext::CpuTime time(context);
    for (size_t i = range.begin(); i < range.end() && !context.cancelled(); ++i) left_counts[i] = partition(block(i));
  });
  if (context.cancelled()) return 0;

  // 2. Right ones before the middle and left ones after it, of which there are as many, change places.
  size_t middle = 0;
  for (const size_t left : left_counts) middle += left;
  MisplacedReferences right_ones, left_ones;
  for (size_t i = 0; i < blocks; ++i) {
    const size_t begin = i * kBlock, cut = begin + left_counts[i], end = begin + block(i).size();
    if (cut < middle) right_ones.AddPiece(references.subspan(cut, std::min(end, middle) - cut));
    if (cut > middle) left_ones.AddPiece(references.subspan(std::max(begin, middle), cut - std::max(begin, middle)));
  }
  tbb::parallel_for(tbb::blocked_range<size_t>(0, right_ones.size(), kBlock),
                    [&](const tbb::blocked_range<size_t>& range) {
                      if (context.cancelled()) return;
                      const BuildContext::CpuTime time(context);
                      right_ones.Swap(left_ones, range.begin(), range.end());
                    });
  return middle;
}

}  // namespace deltaray

#endif  // SERVER_BUILD_PARTITION_H_
