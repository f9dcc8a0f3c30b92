#include "server/tree/traversal_scratch.h"

#include "server/tree/large_memory.h"

namespace deltaray {

TraversalScratch::TraversalScratch(size_t stack_entries, size_t stacks, size_t slots)
    // Whole cache lines, and an odd number of them, so that the stacks' ends do not share the same sets of a cache.
    : stack_entries_((stack_entries + 31) / 32 * 32 + 16), slot_count_(slots) {
  thread_local LargeArray<std::byte> block;
  const size_t slot_bytes = slots * sizeof(RaySlot);
  const size_t column_bytes = stacks * stack_entries_ * sizeof(uint32_t);
  const size_t bytes = slot_bytes + 3 * column_bytes + 5 * (slots + 1) * sizeof(RaySlot*);
  if (block.size() < bytes) block = LargeArray<std::byte>(bytes);
  std::byte* next = block.data();
  slots_ = reinterpret_cast<RaySlot*>(next);
  keys_ = reinterpret_cast<int32_t*>(next += slot_bytes);
  refs_ = reinterpret_cast<uint32_t*>(next += column_bytes);
  parents_ = reinterpret_cast<uint32_t*>(next += column_bytes);
  lists_ = reinterpret_cast<RaySlot**>(next + column_bytes);
}

}  // namespace deltaray
