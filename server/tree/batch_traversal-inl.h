// Many rays in flight through a wide tree, each on its own.

#if defined(SERVER_TREE_BATCH_TRAVERSAL_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_BATCH_TRAVERSAL_INL_H_
#undef SERVER_TREE_BATCH_TRAVERSAL_INL_H_
#else
#define SERVER_TREE_BATCH_TRAVERSAL_INL_H_
#endif

#include <algorithm>
#include <cstdint>
#include <new>
#include <span>
#include <vector>

#include "hwy/highway.h"
#include "server/tree/leaf_lanes-inl.h"
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
constexpr size_t kInFlight = 24;

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
        stop_(scene.stop),
        setup_(scene.arrays),
        scratch_(StackEntries(scene.arrays.levels), in_flight, in_flight),
        next_ray_(static_cast<uint32_t>(begin)) {}

  HWY_ATTR void Run() {
    // Copies, so that the compiler knows that no store changes them.
    const std::byte* const base = base_;
    RaySlot** nodes = scratch_.list(0);
    RaySlot** next_nodes = scratch_.list(1);
    RaySlot** leaves = scratch_.list(2);
    RaySlot** next_leaves = scratch_.list(3);
    RaySlot** const ended = scratch_.list(4);

    size_t node_count = 0, leaf_count = 0;
    for (size_t i = 0; i < in_flight_; ++i) {
      RaySlot& ray = scratch_.slots()[i];
      const size_t bottom = i * scratch_.stack_entries();
      ray.keys = scratch_.keys() + bottom, ray.refs = scratch_.refs() + bottom;
      ray.keys[0] = kBottomKey, ray.refs[0] = kBottomRef;
      nodes[node_count] = &ray;
      node_count += Refill(ray);
    }
    while (node_count + leaf_count > 0) {
      if (HWY_UNLIKELY(stop_.Step(static_cast<uint32_t>(node_count + leaf_count)))) return;
      // The ends of the lists of what is next for a ray: a lookup, since no branch could be foretold.
      RaySlot** ends[3];
      ends[ChildRef::kNode] = next_nodes, ends[ChildRef::kLeaf] = next_leaves, ends[ChildRef::kNothing] = ended;
      const auto go_on = [&](RaySlot& ray) HWY_ATTR {
        const ChildRef next(Pop<Query::kOrdered>(ray));
        ray.current = next.bits();
        if (kPrefetch) Prefetch(base + next.offset() * kUnitBytes);
        *ends[next.kind()]++ = &ray;
      };
      // Not in one loop: what the second one does waits for the end of the first one's long chain, and where it was
      // foretold wrong, all that came after would be done again.
      for (size_t i = 0; i < node_count; ++i) {
        RaySlot& ray = *nodes[i];
        PushChildren<Query::kOrdered>(base + ChildRef(ray.current).offset() * kUnitBytes, ray);
      }
      for (size_t i = 0; i < node_count; ++i) go_on(*nodes[i]);
      // Leaves that have hits are set aside, again so that no branch is taken per leaf.
      size_t hit_count = 0;
      for (size_t i = 0; i < leaf_count; ++i) {
        const RaySlot& ray = *leaves[i];
        const LeafView leaf = ViewOf(ray);
        for (uint32_t first = 0; first < leaf.count; first += kLeafLanes) {
          // In place: where it is assigned, registers that are wider than those that it was written by copy it, and
          // wait until all of that is in the cache.
          const auto* const hit =
              new (&hits_[hit_count]) LeafHit{Test::Start(OneRay{ray}, LeafLanes{leaf, first}), leaves[i], first};
          hit_count += !hn::AllFalse(DLeaf(), hit->start.mask);
        }
      }
      for (size_t i = 0; i < hit_count; ++i) {
        RaySlot& ray = *hits_[i].ray;
        query_.Take(ray, ViewOf(ray), hits_[i].first, hits_[i].start);
      }
      for (size_t i = 0; i < leaf_count; ++i) go_on(*leaves[i]);
      // Rays that may hit something are set aside likewise; leaves, which nobody needs any more, make room for them.
      const size_t ended_count = static_cast<size_t>(ends[ChildRef::kNothing] - ended);
      size_t may_hit_count = 0;
      for (size_t i = 0; i < ended_count; ++i) {
        const RaySlot& ray = *ended[i];
        query_.Miss(ray.ray);
        leaves[may_hit_count] = ended[i];
        may_hit_count += ray.MayHit();
      }
      for (size_t i = 0; i < may_hit_count; ++i) query_.End(*leaves[i]);
      for (size_t i = 0; i < ended_count; ++i) {
        *ends[ChildRef::kNode] = ended[i];
        ends[ChildRef::kNode] += Refill(*ended[i]);
      }
      node_count = static_cast<size_t>(ends[ChildRef::kNode] - next_nodes);
      leaf_count = static_cast<size_t>(ends[ChildRef::kLeaf] - next_leaves);
      std::swap(nodes, next_nodes);
      std::swap(leaves, next_leaves);
    }
  }

 private:
  // A leaf, or a part of one, that has hits.
  struct LeafHit {
    typename Query::First start;
    RaySlot* ray;
    uint32_t first;
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
          Test::SetUp(slot);
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
  StopPoll& stop_;
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
