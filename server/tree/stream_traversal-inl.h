// Neighbouring rays through a wide tree together, each with its own tests, where the order of leaves is all one.

#if defined(SERVER_TREE_STREAM_TRAVERSAL_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_STREAM_TRAVERSAL_INL_H_
#undef SERVER_TREE_STREAM_TRAVERSAL_INL_H_
#else
#define SERVER_TREE_STREAM_TRAVERSAL_INL_H_
#endif

#include <bit>
#include <cstddef>
#include <cstdint>
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

// Rays of a stream: as many as a mask has bits.
constexpr size_t kStreamRays = 32;

// Whether all rays go to the same side along each axis. Rays that do not rarely share their ways.
HWY_ATTR inline bool GoSameWay(std::span<const Ray> rays) {
  const hn::FixedTag<float, 4> d;
  const hn::RebindToUnsigned<decltype(d)> du;
  auto all = hn::Set(du, ~uint32_t{0}), any = hn::Zero(du);
  for (const Ray& ray : rays) {
    const auto bits = hn::BitCast(du, hn::LoadU(d, &ray.direction.x));
    all = hn::And(all, bits), any = hn::Or(any, bits);
  }
  // The fourth lane is an end of the interval.
  return hn::AllFalse(d, hn::And(hn::FirstN(d, 3), hn::MaskFromVec(hn::BitCast(d, hn::Xor(all, any)))));
}

// A stream goes depth-first through the tree, and each entry of its stack says by a mask which of its rays are to look
// at it [Barringer and Akenine-Möller 2014]. A ray tests what it would alone, with the same bits. What is spared is all
// that it does beside tests: a node is found, and its children are pushed, once for all rays.
template <typename Query, bool kPrefetch>
class StreamTraversal {
  using Test = typename Query::Test;
  using Setup = RaySetup<Test::kExact>;
  static_assert(!Query::kOrdered, "rays would disagree on the order of nodes");

 public:
  StreamTraversal(const WideScene& scene, Query& query, std::vector<uint32_t>* odd)
      : base_(scene.arrays.block.data()),
        query_(query),
        odd_(odd),
        stop_(scene.stop),
        setup_(scene.arrays),
        scratch_(StackEntries(scene.arrays.levels), 1, kStreamRays) {}

  // Traces the rays, the first of which has the index `first` in the batch. Returns how many rays an entry of the stack
  // was for, on average. REQUIRES: at most kStreamRays rays.
  HWY_ATTR double Trace(std::span<const Ray> rays, uint32_t first) {
    uint32_t* const masks = reinterpret_cast<uint32_t*>(scratch_.keys());
    uint32_t* const refs = scratch_.refs();
    const uint32_t traced = SetUp(rays, first);
    active_ = traced;
    refs[0] = ChildRef::Node(0).bits();
    masks[0] = traced;
    size_t size = 1, entries = 0, shares = 0;
    while (size > 0) {
      --size;
      const uint32_t mask = masks[size] & active_;
      if (mask == 0) continue;
      // What comes after this: mostly a neighbour of it, and too near to be asked for only when it is its turn.
      if (kPrefetch && size > 0) Prefetch(base_ + ChildRef(refs[size - 1]).offset() * kUnitBytes);
      const auto sharing = static_cast<uint32_t>(std::popcount(mask));
      if (HWY_UNLIKELY(stop_.Step(sharing))) break;
      ++entries;
      shares += sharing;
      const ChildRef ref(refs[size]);
      if (ref.IsLeaf()) {
        TakeLeaf(ref, mask);
      } else {
        size += PushChildren(base_ + ref.offset() * kUnitBytes, mask, masks + size, refs + size);
      }
    }
    for (uint32_t rest = traced; rest != 0; rest &= rest - 1) EndRay(query_, FirstOf(rest));
    return entries == 0 ? 0 : static_cast<double>(shares) / static_cast<double>(entries);
  }

 private:
  RaySlot& FirstOf(uint32_t mask) { return scratch_.slots()[std::countr_zero(mask)]; }

  // Returns the mask of those that are to be traced.
  HWY_ATTR uint32_t SetUp(std::span<const Ray> rays, uint32_t first) {
    uint32_t traced = 0;
    for (uint32_t i = 0; i < rays.size(); ++i) {
      RaySlot& slot = scratch_.slots()[i];
      slot.ray = first + i;
      switch (setup_.Make(rays[i], slot)) {
        case Setup::Kind::kTraced:
          Test::SetUp(slot);
          traced |= 1u << i;
          break;
        case Setup::Kind::kMisses:
          query_.Miss(slot.ray);
          break;
        case Setup::Kind::kOdd:
          odd_->push_back(slot.ray);
          break;
      }
    }
    return traced;
  }

  // Pushes the children that a ray of `mask` enters, each with the mask of those. Returns how many.
  HWY_ATTR HWY_INLINE size_t PushChildren(const std::byte* node, uint32_t mask, uint32_t* masks, uint32_t* refs) {
    const DNode d;
    const DNodeUint du;
    auto entered = hn::Zero(du);
    for (uint32_t rest = mask; rest != 0; rest &= rest - 1) {
      const auto hit = hn::RebindMask(du, TestNode(node, FirstOf(rest)).mask);
      entered = hn::IfThenElse(hit, hn::Or(entered, hn::Set(du, rest & -rest)), entered);
    }
    const auto by_any = hn::RebindMask(d, hn::Ne(entered, hn::Zero(du)));
    const auto children = hn::Load(du, reinterpret_cast<const uint32_t*>(node + 6 * kUnitBytes));
    hn::StoreU(Packed(children, by_any), du, refs);
    hn::StoreU(Packed(entered, by_any), du, masks);
    return hn::CountTrue(d, by_any);
  }

  HWY_ATTR HWY_INLINE void TakeLeaf(ChildRef ref, uint32_t mask) {
    const LeafView leaf{reinterpret_cast<const float*>(base_ + ref.offset() * kUnitBytes), ref.triangles()};
    for (uint32_t rest = mask; rest != 0; rest &= rest - 1) {
      RaySlot& ray = FirstOf(rest);
      for (uint32_t part = 0; part < leaf.count; part += kLeafLanes) {
        const auto start = Test::Start(OneRay{ray}, LeafLanes{leaf, part});
        if (hn::AllFalse(DLeaf(), start.mask)) continue;
        ray.current = ref.bits();
        query_.Take(ray, leaf, part, start);
        if (ray.primitive != kNoPrimitive) active_ &= ~(rest & -rest);
      }
    }
  }

  const std::byte* const base_;
  Query& query_;
  std::vector<uint32_t>* const odd_;
  StopPoll& stop_;
  const Setup setup_;
  TraversalScratch scratch_;
  uint32_t active_ = 0;  // rays whose answer is not known yet
};

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_STREAM_TRAVERSAL_INL_H_
