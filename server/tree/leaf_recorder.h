// Tells which leaves of a wide tree rays come to.

#ifndef SERVER_TREE_LEAF_RECORDER_H_
#define SERVER_TREE_LEAF_RECORDER_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <new>
#include <span>
#include <utility>
#include <vector>

#include "server/tree/wide_arrays.h"

namespace deltaray {

// While it lives, the kernels that run on its thread record the leaves of one tree that they test: of each leaf with a
// label the label, once for all threads. Rays that the kernels do not trace (RayKernels' odd ones) are not recorded.
class LeafRecorder {
 public:
  static constexpr uint32_t kNoLabel = UINT32_MAX;
  struct Leaf {
    size_t unit;  // of the tree's block, where it begins
    uint32_t label;
    bool operator==(const Leaf&) const = default;
  };

  // `labels`: by unit of the tree's block, of the leaf that begins there. A label that is recorded is taken away. Both
  // must outlive the recorder. REQUIRES: the thread has no other one.
  LeafRecorder(const WideArrays& arrays, std::span<std::atomic<uint32_t>> labels)
      : base_(arrays.block.data()), unit_(UnitBytes(Width(arrays.target))), labels_(labels) {
    current_ = this;
  }
  // Gives back the labels of what was recorded and not taken, as where a query throws.
  ~LeafRecorder() {
    current_ = nullptr;
    for (const Leaf& leaf : recorded_) labels_[leaf.unit].store(leaf.label, std::memory_order_relaxed);
  }
  LeafRecorder(const LeafRecorder&) = delete;
  LeafRecorder& operator=(const LeafRecorder&) = delete;

  // This thread's; nullptr: nothing is to be recorded.
  static LeafRecorder* current() { return current_; }

  // `leaf`: where it begins. Without memory it keeps its label.
  void Record(const void* leaf) {
    const size_t unit = static_cast<size_t>(static_cast<const std::byte*>(leaf) - base_) / unit_;
    std::atomic<uint32_t>& label = labels_[unit];
    if (label.load(std::memory_order_relaxed) == kNoLabel) return;
    const uint32_t taken = label.exchange(kNoLabel, std::memory_order_relaxed);
    if (taken == kNoLabel) return;
    try {
      recorded_.push_back({unit, taken});
    } catch (const std::bad_alloc&) {
      label.store(taken, std::memory_order_relaxed);
    }
  }

  // The leaves recorded so far.
  std::vector<Leaf> Take() { return std::exchange(recorded_, {}); }

 private:
  static inline thread_local constinit LeafRecorder* current_ = nullptr;

  const std::byte* const base_;
  const size_t unit_;
  const std::span<std::atomic<uint32_t>> labels_;
  std::vector<Leaf> recorded_;
};

}  // namespace deltaray

#endif  // SERVER_TREE_LEAF_RECORDER_H_
