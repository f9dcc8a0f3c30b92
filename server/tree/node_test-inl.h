// One ray against all boxes of a node at once, and its stack.

#if defined(SERVER_TREE_NODE_TEST_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_NODE_TEST_INL_H_
#undef SERVER_TREE_NODE_TEST_INL_H_
#else
#define SERVER_TREE_NODE_TEST_INL_H_
#endif

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <limits>

#include "hwy/cache_control.h"
#include "hwy/highway.h"
#include "server/tree/ray_slot.h"
#include "server/tree/wide_node.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

using DNode = hn::ScalableTag<float>;
using DNodeInt = hn::RebindToSigned<DNode>;
using DNodeUint = hn::RebindToUnsigned<DNode>;
constexpr int kWidth = hn::MaxLanes(DNode());
constexpr size_t kUnitBytes = UnitBytes(kWidth);

// A key of the stack: the bits of the t at which a box is entered, or of 0 where that is negative, the last four bits
// replaced by the box's lane. So none is negative, nor greater than LimitKey of that t.
constexpr int32_t kLaneMask = 15;

// What lies below all entries of a ray's stack: it always matters, and says that nothing else does.
constexpr int32_t kBottomKey = std::numeric_limits<int32_t>::min();
constexpr uint32_t kBottomRef = ChildRef::kNone;

// Entries with greater keys do not matter to a ray of that limit.
HWY_ATTR HWY_INLINE int32_t LimitKey(float limit) {
  return limit == kNothingMatters ? kBottomKey : std::max(std::bit_cast<int32_t>(limit), 0) | kLaneMask;
}

// Entries that a stack must have room for in a tree of so many levels of nodes.
constexpr size_t StackEntries(uint32_t levels) { return size_t{levels} * (kWidth - 1) + 2 + 2 * kWidth; }

// Sorts 4 or 8 keys from greatest to least by a bitonic network.
template <typename DKeys>
HWY_ATTR HWY_INLINE hn::Vec<DKeys> SortDescending(DKeys d, hn::Vec<DKeys> keys) {
  const auto exchange = [&](hn::Vec<DKeys> partner, auto keep_greater) HWY_ATTR {
    keys = hn::IfThenElse(keep_greater, hn::Max(keys, partner), hn::Min(keys, partner));
  };
  HWY_ALIGN constexpr int32_t kEven[8] = {-1, 0, -1, 0, -1, 0, -1, 0};
  HWY_ALIGN constexpr int32_t kLowPair[8] = {-1, -1, 0, 0, -1, -1, 0, 0};
  const auto even = hn::MaskFromVec(hn::Load(d, kEven)), low_pair = hn::MaskFromVec(hn::Load(d, kLowPair));
  exchange(hn::Shuffle2301(keys), even);
  exchange(hn::Shuffle0123(keys), low_pair);
  exchange(hn::Shuffle2301(keys), even);
  if constexpr (hn::MaxLanes(d) == 8) {
    HWY_ALIGN constexpr int32_t kLowHalf[8] = {-1, -1, -1, -1, 0, 0, 0, 0};
    exchange(hn::Reverse(d, keys), hn::MaskFromVec(hn::Load(d, kLowHalf)));
    exchange(hn::Shuffle1032(keys), low_pair);
    exchange(hn::Shuffle2301(keys), even);
  }
  return keys;
}

// Writes the children of `node` in the lanes `hit`, entered no earlier than at `near`, to keys and refs, the nearest
// last. Returns how many.
HWY_ATTR HWY_INLINE size_t PushSorted(const std::byte* node, hn::Vec<DNode> near, hn::Mask<DNode> hit,
                                      int32_t* out_keys, uint32_t* out_refs) {
  const DNode d;
  const DNodeInt di;
  const DNodeUint du;
  const size_t count = hn::CountTrue(d, hit);
  const auto keys =
      hn::Or(hn::AndNot(hn::Set(di, kLaneMask), hn::Max(hn::BitCast(di, near), hn::Zero(di))), hn::Iota(di, 0));
  const auto children = hn::Load(du, reinterpret_cast<const uint32_t*>(node + 6 * kUnitBytes));
#if HWY_TARGET == HWY_AVX3
  // Lanes past the last one are 0, as if the first child came again; only a key of that child itself is as low as
  // theirs.
  const hn::Vec<DNodeInt> packed{_mm512_maskz_compress_epi32(hit.raw, keys.raw)};
  if (HWY_LIKELY(count <= 4)) {
    const hn::FixedTag<int32_t, 4> dk;
    const auto sorted = SortDescending(dk, hn::LowerHalf(hn::LowerHalf(packed)));
    hn::StoreU(sorted, dk, out_keys);
    const hn::Vec<DNodeUint> refs{_mm512_permutexvar_epi32(_mm512_castsi128_si512(sorted.raw), children.raw)};
    hn::StoreU(hn::LowerHalf(hn::LowerHalf(refs)), hn::RebindToUnsigned<decltype(dk)>(), out_refs);
    return count;
  }
  if (HWY_LIKELY(count <= 8)) {
    const hn::FixedTag<int32_t, 8> dk;
    const auto sorted = SortDescending(dk, hn::LowerHalf(packed));
    hn::StoreU(sorted, dk, out_keys);
    const hn::Vec<DNodeUint> refs{_mm512_permutexvar_epi32(_mm512_castsi256_si512(sorted.raw), children.raw)};
    hn::StoreU(hn::LowerHalf(hn::Half<DNodeUint>(), refs), hn::Half<DNodeUint>(), out_refs);
    return count;
  }
  hn::StoreU(packed, di, out_keys);
  std::sort(out_keys, out_keys + count, [](int32_t a, int32_t b) { return a > b; });
  for (size_t i = 0; i < count; ++i) {
    out_refs[i] = reinterpret_cast<const uint32_t*>(node + 6 * kUnitBytes)[out_keys[i] & kLaneMask];
  }
#else
  // Lanes that are not hit are 0, as if the first child came again; only a key of that child itself is as low as
  // theirs.
  const auto sorted = SortDescending(di, hn::IfThenElseZero(hn::RebindMask(di, hit), keys));
  hn::StoreU(sorted, di, out_keys);
  const auto lanes = hn::And(sorted, hn::Set(di, kWidth - 1));
  hn::StoreU(hn::TableLookupLanes(children, hn::IndicesFromVec(du, lanes)), du, out_refs);
#endif
  return count;
}

#if HWY_TARGET != HWY_AVX3
// By the bits of a mask: its lanes, in order, and then any.
constexpr auto kLanesOfMask = [] {
  std::array<std::array<uint8_t, kWidth>, size_t{1} << kWidth> lanes_of_mask{};
  for (size_t mask = 0; mask < lanes_of_mask.size(); ++mask) {
    for (size_t lane = 0, count = 0; lane < kWidth; ++lane) {
      if (mask >> lane & 1) lanes_of_mask[mask][count++] = static_cast<uint8_t>(lane);
    }
  }
  return lanes_of_mask;
}();
#endif

// The lanes of `refs` that are in `mask`, moved together; then any.
HWY_ATTR HWY_INLINE hn::Vec<DNodeUint> Packed(hn::Vec<DNodeUint> refs, hn::Mask<DNode> mask) {
  const DNodeUint du;
#if HWY_TARGET == HWY_AVX3
  return hn::Compress(refs, hn::RebindMask(du, mask));
#else
  // Highway's own has a table that gcc copies to the stack at each call.
  uint8_t bits[8] = {};
  hn::StoreMaskBits(DNode(), mask, bits);
  const hn::Rebind<uint8_t, DNodeUint> du8;
  const auto lanes = hn::PromoteTo(du, hn::LoadU(du8, kLanesOfMask[bits[0]].data()));
  return hn::TableLookupLanes(refs, hn::IndicesFromVec(du, lanes));
#endif
}

// The boxes of a node that a ray enters within its range, and no later than when.
struct NodeHits {
  hn::Mask<DNode> mask;
  hn::Vec<DNode> near;
};

HWY_ATTR HWY_INLINE NodeHits TestNode(const std::byte* node, const RaySlot& ray) {
  const DNode d;
  const auto face = [&](int axis, uint32_t upper) HWY_ATTR {
    return hn::Load(d, reinterpret_cast<const float*>(node + 2 * axis * kUnitBytes + upper));
  };
  const auto cross = [&](int axis, uint32_t upper, const float* offset) HWY_ATTR {
    return hn::MulAdd(face(axis, upper), hn::Set(d, ray.inverse[axis]), hn::Set(d, offset[axis]));
  };
  const auto near_x = cross(0, ray.flip[0], ray.near_offset),
             far_x = cross(0, ~ray.flip[0] & kUnitBytes, ray.far_offset);
  const auto near_y = cross(1, ray.flip[1], ray.near_offset),
             far_y = cross(1, ~ray.flip[1] & kUnitBytes, ray.far_offset);
  const auto near_z = cross(2, ray.flip[2], ray.near_offset),
             far_z = cross(2, ~ray.flip[2] & kUnitBytes, ray.far_offset);
  const auto near = hn::Max(hn::Max(near_x, near_y), hn::Max(near_z, hn::Set(d, ray.t_min)));
  const auto far = hn::Min(hn::Min(far_x, far_y), hn::Min(far_z, hn::Set(d, ray.limit)));
  return {hn::Le(near, far), near};
}

// Pushes the children of `node` whose boxes the ray enters within its range: the nearest last, or in any order and
// without keys.
template <bool kOrdered>
HWY_ATTR HWY_INLINE void PushChildren(const std::byte* node, RaySlot& ray) {
  const NodeHits hits = TestNode(node, ray);
  uint32_t* const refs = ray.refs + ray.stack_size;
  if (kOrdered) {
    ray.stack_size += static_cast<uint32_t>(PushSorted(node, hits.near, hits.mask, ray.keys + ray.stack_size, refs));
  } else {
    const DNodeUint du;
    const auto children = hn::Load(du, reinterpret_cast<const uint32_t*>(node + 6 * kUnitBytes));
    hn::StoreU(Packed(children, hits.mask), du, refs);
    ray.stack_size += static_cast<uint32_t>(hn::CountTrue(DNode(), hits.mask));
  }
}

// Takes the last entry that still matters off the ray's stack, and returns its ref. REQUIRES: the bottom is on it.
template <bool kOrdered>
HWY_ATTR HWY_INLINE uint32_t Pop(RaySlot& ray) {
  uint32_t top = ray.stack_size - 1;
  if (kOrdered) {
    while (ray.keys[top] > ray.limit_key) --top;
  }
  ray.stack_size = top;
  return ray.refs[top];
}

// Brings what stands at `data` nearer, where the tree is too large for the caches. As much as a node has, whatever it
// is: no branch.
HWY_ATTR HWY_INLINE void Prefetch(const std::byte* data) {
  constexpr size_t kCacheLine = 64;
  for (size_t at = 0; at < NodeBytes(kWidth); at += kCacheLine) hwy::Prefetch(data + at);
}

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_NODE_TEST_INL_H_
