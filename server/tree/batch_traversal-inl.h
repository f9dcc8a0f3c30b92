// Many rays in flight through a wide tree, each on its own.

#if defined(SERVER_TREE_BATCH_TRAVERSAL_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_BATCH_TRAVERSAL_INL_H_
#undef SERVER_TREE_BATCH_TRAVERSAL_INL_H_
#else
#define SERVER_TREE_BATCH_TRAVERSAL_INL_H_
#endif

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "hwy/highway.h"
#include "server/tree/leaf_test-inl.h"
#include "server/tree/node_test-inl.h"
#include "server/tree/ray_kernels.h"
#include "server/tree/ray_setup-inl.h"
#include "server/tree/traversal_scratch.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

// Trees above this size do not fit in a core's own cache.
constexpr size_t kPrefetchBytes = size_t{2} << 20;

// Rays in flight: enough to hide the time that memory takes.
constexpr size_t kInFlight = 32;

// Parts in which a leaf is tested.
constexpr size_t kLeafParts = kMaxLeafTriangles / kLeafLanes;

// Leads the rays of a batch through the tree. All rays in flight take a step in a node, then all that have come to a
// leaf test it, and so on: while the memory that one ray waits for is on its way, the others work. `Query` says what is
// made of the leaves (queries-inl.h).
template <typename Query, bool kPrefetch>
class BatchTraversal {
  using Test = typename Query::Test;
  using Setup = RaySetup<Test::kExact>;

 public:
  // Rays begin to end - 1 of `rays`.
  BatchTraversal(const WideScene& scene, std::span<const Ray> rays, size_t begin, size_t end, Query& query,
                 size_t in_flight, std::vector<uint32_t>* odd)
      : base_(scene.arrays.block.data()),
        rays_(rays.first(end)),
        query_(query),
        in_flight_(in_flight),
        odd_(odd),
        setup_(scene.arrays),
        scratch_(StackEntries(scene.arrays.levels), in_flight, in_flight),
        next_ray_(static_cast<uint32_t>(begin)) {}

  HWY_ATTR void Run() {
    // Copies, so that the compiler knows that no store changes them.
    const std::byte* const base = base_;
    RaySlot* const slots = scratch_.slots();
    const size_t stack_entries = scratch_.stack_entries();
    int32_t* const keys = scratch_.keys();
    uint32_t* const refs = scratch_.refs();
    uint32_t* nodes = scratch_.list(0);
    uint32_t* next_nodes = scratch_.list(1);
    uint32_t* leaves = scratch_.list(2);
    uint32_t* next_leaves = scratch_.list(3);

    uint32_t* const ended = scratch_.list(4);

    size_t node_count = 0, leaf_count = 0;
    for (size_t i = 0; i < in_flight_; ++i) {
      keys[i * stack_entries] = kBottomKey;
      refs[i * stack_entries] = kBottomRef;
      nodes[node_count] = static_cast<uint32_t>(i);
      node_count += Refill(slots[i]);
    }
    while (node_count + leaf_count > 0) {
      size_t next_node_count = 0, next_leaf_count = 0, ended_count = 0;
      // Leads a slot to what is next for it. All lists are written to, but one in vain: no branch could be foretold.
      const auto go_on = [&](uint32_t index, RaySlot& ray, const RayStack& stack) HWY_ATTR {
        const uint32_t next = ray.current = Pop<Query::kOrdered>(ray, stack);
        if (kPrefetch) Prefetch(base + ChildRef(next).offset() * kUnitBytes);
        const size_t is_leaf = ChildRef(next).IsLeaf(), has_ended = next == kBottomRef;
        next_nodes[next_node_count] = index;
        next_node_count += 1 - is_leaf - has_ended;
        next_leaves[next_leaf_count] = index;
        next_leaf_count += is_leaf;
        ended[ended_count] = index;
        ended_count += has_ended;
      };
      for (size_t i = 0; i < node_count; ++i) {
        const uint32_t index = nodes[i];
        RaySlot& ray = slots[index];
        const RayStack stack{keys + index * stack_entries, refs + index * stack_entries};
        PushChildren<Query::kOrdered>(base + ChildRef(ray.current).offset() * kUnitBytes, ray, stack);
        go_on(index, ray, stack);
      }
      // Leaves that have hits are set aside, again so that no branch is taken per leaf.
      size_t hit_count = 0;
      for (size_t i = 0; i < leaf_count; ++i) {
        const RaySlot& ray = slots[leaves[i]];
        const LeafView leaf = ViewOf(ray);
        for (uint32_t first = 0; first < leaf.count; first += kLeafLanes) {
          LeafHit& hit = hits_[hit_count];
          hit.start = Test::Start(ray, leaf, first);
          hit.slot = leaves[i];
          hit.first = first;
          hit_count += !hn::AllFalse(DLeaf(), hit.start.mask);
        }
      }
      for (size_t i = 0; i < hit_count; ++i) {
        RaySlot& ray = slots[hits_[i].slot];
        query_.Take(ray, ViewOf(ray), hits_[i].first, hits_[i].start);
      }
      for (size_t i = 0; i < leaf_count; ++i) {
        const uint32_t index = leaves[i];
        go_on(index, slots[index], {keys + index * stack_entries, refs + index * stack_entries});
      }
      // Rays that may hit something are set aside likewise; leaves, which nobody needs any more, make room for them.
      size_t may_hit_count = 0;
      for (size_t i = 0; i < ended_count; ++i) {
        const RaySlot& ray = slots[ended[i]];
        query_.Miss(ray.ray);
        leaves[may_hit_count] = ended[i];
        may_hit_count += ray.MayHit();
      }
      for (size_t i = 0; i < may_hit_count; ++i) query_.End(slots[leaves[i]]);
      for (size_t i = 0; i < ended_count; ++i) {
        const uint32_t index = ended[i];
        next_nodes[next_node_count] = index;
        next_node_count += Refill(slots[index]);
      }
      std::swap(nodes, next_nodes);
      std::swap(leaves, next_leaves);
      node_count = next_node_count, leaf_count = next_leaf_count;
    }
  }

 private:
  // A leaf, or a part of one, that has hits.
  struct LeafHit {
    typename Test::First start;
    uint32_t slot, first;
  };

  // The leaf that a ray has come to.
  HWY_ATTR HWY_INLINE LeafView ViewOf(const RaySlot& ray) const {
    const ChildRef leaf(ray.current);
    return {reinterpret_cast<const float*>(base_ + leaf.offset() * kUnitBytes), leaf.triangles()};
  }

  // Puts the next ray that is to be traced in the slot, at the root. False: there is none.
  HWY_ATTR bool Refill(RaySlot& slot) {
    while (next_ray_ < rays_.size()) {
      slot.ray = next_ray_++;
      switch (setup_.Make(rays_[slot.ray], slot)) {
        case Setup::Kind::kTraced:
          slot.current = ChildRef::Node(0).bits();
          Query::SetUp(slot);
          return true;
        case Setup::Kind::kMisses:
          query_.Miss(slot.ray);
          break;
        case Setup::Kind::kOdd:
          odd_->push_back(slot.ray);
          break;
      }
    }
    return false;
  }

  const std::byte* const base_;
  const std::span<const Ray> rays_;
  Query& query_;
  const size_t in_flight_;
  std::vector<uint32_t>* const odd_;
  const Setup setup_;
  TraversalScratch scratch_;
  uint32_t next_ray_;
  // One more than there can be: the next one is written in advance.
  LeafHit hits_[kInFlight * kLeafParts + 1];
};

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_BATCH_TRAVERSAL_INL_H_
