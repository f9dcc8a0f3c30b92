// Coherent rays through a wide tree, many together.

#if defined(SERVER_TREE_PACKET_TRAVERSAL_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_PACKET_TRAVERSAL_INL_H_
#undef SERVER_TREE_PACKET_TRAVERSAL_INL_H_
#else
#define SERVER_TREE_PACKET_TRAVERSAL_INL_H_
#endif

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>

#include "hwy/highway.h"
#include "server/tree/leaf_test-inl.h"
#include "server/tree/node_test-inl.h"
#include "server/tree/ray_kernels.h"
#include "server/tree/ray_setup-inl.h"
#include "server/tree/traversal_scratch.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

// Rays of a packet.
constexpr size_t kPacketRays = 16;

// A packet is led through the nodes as the interval of all its rays [Boulos 2006]: one test of a node's boxes for all
// of them. At a leaf each ray tries the leaf's box, and those that meet it test the leaf as they would alone, so that
// answers are the same bits.
template <typename Query>
class PacketTraversal {
  using Setup = RaySetup<Query::Test::kExact>;
  using VNode = hn::Vec<DNode>;

 public:
  PacketTraversal(const WideScene& scene, Query& query)
      : base_(scene.arrays.block.data()),
        query_(query),
        setup_(scene.arrays),
        scratch_(StackEntries(scene.arrays.levels), 1, kPacketRays) {}

  enum class Outcome : uint8_t {
    kTraced,
    kRefused,  // at once: the rays do not go the same way
    kGaveUp,   // on the way: where they go, too few rays come to the same leaf for a packet to pay
  };

  // Traces the rays, the first of which has the index `first` in the batch; or else has answered none. `always`: takes
  // packets however wide, and does not give up. REQUIRES: as many rays as a packet has.
  HWY_ATTR Outcome Trace(std::span<const Ray> rays, uint32_t first, bool always) {
    if (!FindBounds(rays, always)) return Outcome::kRefused;
    rays_ = rays;
    first_ = first;
    rays_are_set_up_ = false;
    if (!Traverse(always)) return Outcome::kGaveUp;
    if (rays_are_set_up_) {
      for (size_t i = 0; i < kPacketRays; ++i) EndRay(query_, slots()[i]);
    } else {
      for (uint32_t i = 0; i < kPacketRays; ++i) query_.Miss(first + i);
    }
    return Outcome::kTraced;
  }

 private:
  using D4 = hn::FixedTag<float, 4>;
  using V4 = hn::Vec<D4>;

  RaySlot* slots() { return scratch_.slots(); }

  // Sums up the packet. False: its rays do not go the same way.
  HWY_ATTR bool FindBounds(std::span<const Ray> rays, bool wide) {
    if (!wide && StartApart(rays.front(), rays.back())) return false;
    // 1. The ranges of all that a ray has: x, y, z of the origin and t_min; x, y, z of the direction and t_max. Four
    // rays at a time, so that they need not wait for each other.
    const hn::CappedTag<float, 8> d;
    HWY_ALIGN float lows[8], highs[8];
    for (size_t part = 0; part < 8; part += hn::Lanes(d)) {
      const auto load = [&](size_t i) HWY_ATTR { return hn::LoadU(d, &rays[i].origin.x + part); };
      auto low0 = load(0), low1 = load(1), low2 = load(2), low3 = load(3);
      auto high0 = low0, high1 = low1, high2 = low2, high3 = low3;
      for (size_t i = 4; i < kPacketRays; i += 4) {
        const auto ray0 = load(i), ray1 = load(i + 1), ray2 = load(i + 2), ray3 = load(i + 3);
        low0 = hn::Min(low0, ray0), low1 = hn::Min(low1, ray1), low2 = hn::Min(low2, ray2), low3 = hn::Min(low3, ray3);
        high0 = hn::Max(high0, ray0), high1 = hn::Max(high1, ray1), high2 = hn::Max(high2, ray2),
        high3 = hn::Max(high3, ray3);
      }
      hn::Store(hn::Min(hn::Min(low0, low1), hn::Min(low2, low3)), d, lows + part);
      hn::Store(hn::Max(hn::Max(high0, high1), hn::Max(high2, high3)), d, highs + part);
    }
    float *const origin_low = lows, *const origin_high = highs, *const direction_low = lows + 4,
                 *const direction_high = highs + 4;

    // 2. All must go to the same side along each axis, else a box's near faces are not the same for all; 0 counts as
    // upward. Scale by the least of the greatest components.
    int main = 0;
    float main_least = 0;
    for (int axis = 0; axis < 3; ++axis) {
      if (direction_low[axis] < 0 && direction_high[axis] >= 0) return false;
      const float least = direction_low[axis] < 0 ? -direction_high[axis] : direction_low[axis];
      if (least > main_least) main = axis, main_least = least;
    }
    const float main_greatest = std::max(-direction_low[main], direction_high[main]);
    if (!(main_least >= Setup::kLeastDirection && main_greatest < Setup::kGreatestDirection)) return false;
    exponent_ = Setup::ExponentOf(main_least);
    const float direction_scale = Setup::DirectionScale(exponent_);
    // In double: the scale of a mesh of subnormal coordinates is beyond float.
    const double scale = setup_.scale();

    float widest = 0, apart = 0, reach = 0;
    for (int axis = 0; axis < 3; ++axis) {
      origin_low[axis] = static_cast<float>(origin_low[axis] * scale);
      origin_high[axis] = static_cast<float>(origin_high[axis] * scale);
      direction_low[axis] *= direction_scale, direction_high[axis] *= direction_scale;
      // Components that count as 0 count as upward too.
      if (direction_low[axis] < 0 && direction_high[axis] > -kLeastComponent) return false;
      reach = std::max({reach, std::abs(origin_low[axis]), std::abs(origin_high[axis])});
      widest = std::max(widest, direction_high[axis] - direction_low[axis]);
      apart = std::max(apart, origin_high[axis] - origin_low[axis]);
    }
    // The mesh is 1 to 2 wide, and what a packet meets in it must not be much narrower than the packet: neither far
    // away nor near the origins, where rays that start from a surface would meet most of what is around them. What is
    // so wide that the frame does not suit it is refused in any case, and NaN.
    if (!(reach <= kFarthestOrigin && widest <= kFarthestOrigin)) return false;
    if (!wide && !(widest < kWidestPacket && apart < kWidestStart)) return false;

    // 3. Bounds for the test of a node.
    reach += 1;
    for (int axis = 0; axis < 3; ++axis) {
      const bool negative = direction_low[axis] < 0;
      flip_[axis] = negative ? kUnitBytes : 0;
      near_origin_[axis] = negative ? origin_low[axis] : origin_high[axis];
      far_origin_[axis] = negative ? origin_high[axis] : origin_low[axis];
      inverse_low_[axis] = Inverse(direction_high[axis]), inverse_high_[axis] = Inverse(direction_low[axis]);
      const float greatest = std::max(std::abs(inverse_low_[axis]), std::abs(inverse_high_[axis]));
      // As a ray's own: more than the roundings of the test, and than a component that counts as 0 leads astray.
      pad_[axis] = reach * 0x1p-20f * greatest + (greatest >= 1 / kLeastComponent ? 4 * reach : 0);
    }
    const double t_scale = setup_.TScale(exponent_);
    least_t_min_ = std::max(static_cast<float>(origin_low[3] * t_scale), -2 * reach);
    SetGreatestLimit(std::min(static_cast<float>(direction_high[3] * t_scale), 2 * reach));
    return true;
  }

  // For most packets that start too far apart, the first ray and the last one tell.
  HWY_ATTR bool StartApart(const Ray& a, const Ray& b) const {
    const D4 d;
    const V4 apart = hn::Abs(hn::Sub(hn::LoadU(d, &a.origin.x), hn::LoadU(d, &b.origin.x)));
    const V4 most = hn::Set(d, static_cast<float>(kWidestStart / setup_.scale()));
    return !hn::AllFalse(d, hn::And(hn::FirstN(d, 3), hn::Ge(apart, most)));
  }

  // As RaySetup has it.
  static float Inverse(float component) {
    return std::abs(component) < kLeastComponent ? 1 / kLeastComponent : 1 / component;
  }

  // Fills the slots and columns of all rays: not before one has come to a leaf.
  HWY_ATTR void SetUpRays() {
    rays_are_set_up_ = true;
    for (size_t i = 0; i < kPacketRays; ++i) {
      RaySlot& slot = slots()[i];
      slot.ray = first_ + static_cast<uint32_t>(i);
      // None is odd, by FindBounds.
      const bool traced = setup_.Make(rays_[i], exponent_, slot) == Setup::Kind::kTraced;
      Query::SetUp(slot);
      for (int axis = 0; axis < 3; ++axis) {
        inverse_[axis][i] = slot.inverse[axis];
        near_offset_[axis][i] = slot.near_offset[axis];
        far_offset_[axis][i] = slot.far_offset[axis];
      }
      t_min_[i] = slot.t_min;
      limit_[i] = traced ? slot.limit : kNothingMatters;
    }
  }

  // False: gave up.
  HWY_ATTR bool Traverse(bool always) {
    uint32_t leaves = 0, tests = 0;
    PacketStack stack{scratch_.keys(), scratch_.refs(), scratch_.parents()};
    uint32_t size = 0;
    uint32_t current = ChildRef::Node(0).bits();
    uint32_t parent = 0;
    while (true) {
      const ChildRef ref(current);
      if (ref.IsLeaf()) {
        ++leaves;
        tests += VisitLeaf(ref, parent);
        if (HWY_UNLIKELY(tests < leaves && leaves > kTrialLeaves && !always)) return false;
      } else {
        size = Push(ref.offset(), stack, size);
      }
      // The nearest one that still matters.
      do {
        if (size == 0) return true;
        --size;
      } while (stack.keys[size] > limit_key_);
      current = stack.refs[size];
      parent = stack.parents[size];
    }
  }

  struct PacketStack {
    int32_t* keys;
    uint32_t* refs;
    uint32_t* parents;  // the node's offset, of which a leaf is a child
  };

  // Pushes the children that some ray of the packet may enter. Returns the stack's size.
  HWY_ATTR HWY_INLINE uint32_t Push(uint32_t node_offset, const PacketStack& stack, uint32_t size) {
    const DNode d;
    const std::byte* const node = base_ + node_offset * kUnitBytes;
    const auto face = [&](int axis, uint32_t upper) HWY_ATTR {
      return hn::Load(d, reinterpret_cast<const float*>(node + 2 * axis * kUnitBytes + upper));
    };
    VNode near = hn::Set(d, least_t_min_), far = hn::Set(d, greatest_limit_);
    for (int axis = 0; axis < 3; ++axis) {
      const VNode low = hn::Set(d, inverse_low_[axis]), high = hn::Set(d, inverse_high_[axis]);
      const VNode to_near = hn::Sub(face(axis, flip_[axis]), hn::Set(d, near_origin_[axis]));
      const VNode to_far = hn::Sub(face(axis, kUnitBytes - flip_[axis]), hn::Set(d, far_origin_[axis]));
      const VNode pad = hn::Set(d, pad_[axis]);
      near = hn::Max(near, hn::Sub(hn::Min(hn::Mul(to_near, low), hn::Mul(to_near, high)), pad));
      far = hn::Min(far, hn::Add(hn::Max(hn::Mul(to_far, low), hn::Mul(to_far, high)), pad));
    }
    const size_t count = PushSorted(node, near, hn::Le(near, far), stack.keys + size, stack.refs + size);
    for (size_t i = 0; i < count; ++i) stack.parents[size + i] = node_offset;
    return size + static_cast<uint32_t>(count);
  }

  // Lets the rays that meet the leaf's box test it, and returns how many do.
  HWY_ATTR HWY_INLINE uint32_t VisitLeaf(ChildRef leaf, uint32_t parent) {
    const DNode d;
    if (HWY_UNLIKELY(!rays_are_set_up_)) SetUpRays();
    const std::byte* const node = base_ + parent * kUnitBytes;
    // Which child of its parent the leaf is, tells where its box is.
    const hn::RebindToUnsigned<DNode> du;
    const auto children = hn::Load(du, reinterpret_cast<const uint32_t*>(node + 6 * kUnitBytes));
    const size_t lane = hn::FindFirstTrue(du, hn::Eq(children, hn::Set(du, leaf.bits())));
    const auto face = [&](int axis, uint32_t upper) HWY_ATTR {
      return hn::Set(d, *(reinterpret_cast<const float*>(node + 2 * axis * kUnitBytes + upper) + lane));
    };
    const VNode near_x = face(0, flip_[0]), near_y = face(1, flip_[1]), near_z = face(2, flip_[2]);
    const VNode far_x = face(0, kUnitBytes - flip_[0]), far_y = face(1, kUnitBytes - flip_[1]),
                far_z = face(2, kUnitBytes - flip_[2]);
    const LeafView view{reinterpret_cast<const float*>(base_ + leaf.offset() * kUnitBytes), leaf.triangles()};
    bool closer = false;
    uint32_t tests = 0;
    for (size_t first = 0; first < kPacketRays; first += kWidth) {
      const auto cross = [&](VNode plane, int axis, const float* offset) HWY_ATTR {
        return hn::MulAdd(plane, hn::Load(d, inverse_[axis] + first), hn::Load(d, offset + first));
      };
      const VNode near = hn::Max(hn::Max(cross(near_x, 0, near_offset_[0]), cross(near_y, 1, near_offset_[1])),
                                 hn::Max(cross(near_z, 2, near_offset_[2]), hn::Load(d, t_min_ + first)));
      const VNode far = hn::Min(hn::Min(cross(far_x, 0, far_offset_[0]), cross(far_y, 1, far_offset_[1])),
                                hn::Min(cross(far_z, 2, far_offset_[2]), hn::Load(d, limit_ + first)));
      uint8_t bits[8] = {};
      hn::StoreMaskBits(d, hn::Le(near, far), bits);
      const uint32_t met = bits[0] | uint32_t{bits[1]} << 8;
      tests += static_cast<uint32_t>(std::popcount(met));
      for (uint32_t rest = met; rest != 0; rest &= rest - 1) {
        const size_t i = first + static_cast<size_t>(std::countr_zero(rest));
        RaySlot& ray = slots()[i];
        ray.current = leaf.bits();
        for (uint32_t part = 0; part < view.count; part += kLeafLanes) {
          const auto start = Query::Test::Start(ray, view, part);
          if (!hn::AllFalse(DLeaf(), start.mask)) query_.Take(ray, view, part, start);
        }
        const float limit = Query::Limit(ray);
        closer |= limit < limit_[i];
        limit_[i] = limit;
      }
    }
    if (closer) UpdateLimit();
    return tests;
  }

  HWY_ATTR HWY_INLINE void UpdateLimit() {
    const DNode d;
    VNode greatest = hn::Load(d, limit_);
    for (size_t i = kWidth; i < kPacketRays; i += kWidth) greatest = hn::Max(greatest, hn::Load(d, limit_ + i));
    SetGreatestLimit(hn::GetLane(hn::MaxOfLanes(d, greatest)));
  }

  void SetGreatestLimit(float limit) {
    greatest_limit_ = limit;
    limit_key_ = LimitKey(limit);
  }

  static constexpr float kWidestPacket = 0.25f, kWidestStart = 0x1p-9f;
  // Leaves that a packet comes to before it is asked whether it pays: at less than a test each, it does not.
  static constexpr uint32_t kTrialLeaves = 32;

  const std::byte* const base_;
  Query& query_;
  const Setup setup_;
  TraversalScratch scratch_;

  std::span<const Ray> rays_;
  uint32_t first_ = 0;
  int exponent_ = 0;  // of the directions; see RaySetup
  bool rays_are_set_up_ = false;
  // Of all rays together: which faces are near, and bounds of what enters the test.
  uint32_t flip_[3];
  float near_origin_[3], far_origin_[3], inverse_low_[3], inverse_high_[3], pad_[3];
  float least_t_min_ = 0, greatest_limit_ = 0;
  int32_t limit_key_ = 0;
  // Of each ray.
  HWY_ALIGN float inverse_[3][kPacketRays];
  HWY_ALIGN float near_offset_[3][kPacketRays];
  HWY_ALIGN float far_offset_[3][kPacketRays];
  HWY_ALIGN float t_min_[kPacketRays];
  HWY_ALIGN float limit_[kPacketRays];
};

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_PACKET_TRAVERSAL_INL_H_
