// Memory that a traversal works in, kept by the thread.

#ifndef SERVER_TREE_TRAVERSAL_SCRATCH_H_
#define SERVER_TREE_TRAVERSAL_SCRATCH_H_

#include <cstddef>
#include <cstdint>

#include "server/tree/ray_slot.h"

namespace deltaray {

// Stacks of the rays, or packets, that one thread has in flight, slots for their rays, and lists. A thread keeps its
// memory from one batch to the next; it lies on the heap, since a large thread_local object would make threads fail to
// start.
class TraversalScratch {
 public:
  // At most one object a thread at any time. Throws std::bad_alloc.
  TraversalScratch(size_t stack_entries, size_t stacks, size_t slots);

  RaySlot* slots() { return slots_; }
  // Stack i begins at entry i * stack_entries() of three columns.
  size_t stack_entries() const { return stack_entries_; }
  int32_t* keys() { return keys_; }
  uint32_t* refs() { return refs_; }
  uint32_t* parents() { return parents_; }
  // Five lists of slots, each with room for one more than there are.
  RaySlot** list(size_t i) { return lists_ + i * (slot_count_ + 1); }

 private:
  size_t stack_entries_, slot_count_;
  RaySlot* slots_;
  int32_t* keys_;
  uint32_t* refs_;
  uint32_t* parents_;
  RaySlot** lists_;
};

}  // namespace deltaray

#endif  // SERVER_TREE_TRAVERSAL_SCRATCH_H_
