// What the rays of a packet have in common: the interval that they are led through nodes as.

#if defined(SERVER_TREE_PACKET_BOUNDS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_PACKET_BOUNDS_INL_H_
#undef SERVER_TREE_PACKET_BOUNDS_INL_H_
#else
#define SERVER_TREE_PACKET_BOUNDS_INL_H_
#endif

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>

#include "hwy/highway.h"
#include "server/tree/leaf_lanes-inl.h"
#include "server/tree/node_test-inl.h"
#include "server/tree/ray_setup-inl.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

// An interval of rays [Boulos 2006]: it enters every box that one of them does.
template <typename Setup>
class PacketBounds {
  using D4 = hn::FixedTag<float, 4>;
  using V4 = hn::Vec<D4>;

 public:
  // Sums up the rays. False: they do not go the same way. `wide`: they may be however wide apart.
  // REQUIRES: as many rays as a packet has.
  HWY_ATTR bool Find(std::span<const Ray> rays, const Setup& setup, bool wide) {
    if (!wide && StartApart(rays.front(), rays.back(), setup)) return false;
    static_assert(offsetof(Ray, t_min) == 12 && offsetof(Ray, direction) == 16 && offsetof(Ray, t_max) == 28);
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
    const D4 d4;
    V4 origin_low = hn::Load(d4, lows), direction_low = hn::Load(d4, lows + 4);
    V4 origin_high = hn::Load(d4, highs), direction_high = hn::Load(d4, highs + 4);
    const auto xyz = hn::FirstN(d4, 3);
    const auto any = [&](hn::Mask<D4> mask) HWY_ATTR { return !hn::AllFalse(d4, hn::And(mask, xyz)); };

    // 2. All must go to the same side along each axis, else a box's near faces are not the same for all; 0 counts as
    // upward. Scale by the least of the greatest components.
    const V4 zero = hn::Zero(d4);
    const auto negative = hn::Lt(direction_low, zero);
    if (any(hn::And(negative, hn::Ge(direction_high, zero)))) return false;
    const float main_least = Setup::Greatest(hn::IfThenElse(negative, direction_high, direction_low));
    const float greatest_of_all = Setup::Greatest(hn::Max(hn::Neg(direction_low), direction_high));
    if (!(main_least >= Setup::kLeastDirection && greatest_of_all < Setup::kGreatestDirection)) return false;
    exponent_ = Setup::ExponentOf(main_least);
    const V4 direction_scale = hn::Set(d4, Setup::DirectionScale(exponent_));
    origin_low = Setup::Times(origin_low, setup.scale()), origin_high = Setup::Times(origin_high, setup.scale());
    direction_low = hn::Mul(direction_low, direction_scale), direction_high = hn::Mul(direction_high, direction_scale);
    // Components that count as 0 count as upward too.
    if (any(hn::And(negative, hn::Gt(direction_high, hn::Set(d4, -kLeastComponent))))) return false;
    // The frame is 2 wide, the mesh at most that, and what a packet meets in it must not be much narrower than the
    // packet: neither far away nor near the origins, where rays that start from a surface would meet most of what is
    // around them. What is so wide that the frame does not suit it is refused in any case, and NaN.
    const float farthest = std::max(Setup::Greatest(origin_low), Setup::Greatest(origin_high));
    const V4 wideness = hn::Sub(direction_high, direction_low), apart = hn::Sub(origin_high, origin_low);
    const auto narrower = [&](V4 x, float limit) HWY_ATTR { return !any(hn::Not(hn::Lt(x, hn::Set(d4, limit)))); };
    if (!(farthest <= kFarthestOrigin && narrower(wideness, kFarthestOrigin))) return false;
    if (!wide && !(narrower(wideness, kWidestPacket) && narrower(apart, kWidestStart))) return false;

    // 3. Bounds for the test of a node.
    const float reach = farthest + 1;
    const hn::RebindToUnsigned<D4> du4;
    hn::Store(hn::IfThenElseZero(hn::RebindMask(du4, negative), hn::Set(du4, kUnitBytes)), du4, flip_);
    hn::Store(hn::IfThenElse(negative, origin_low, origin_high), d4, near_origin_);
    hn::Store(hn::IfThenElse(negative, origin_high, origin_low), d4, far_origin_);
    const V4 inverse_low = Setup::Inverse(direction_high), inverse_high = Setup::Inverse(direction_low);
    hn::Store(inverse_low, d4, inverse_low_);
    hn::Store(inverse_high, d4, inverse_high_);
    const V4 greatest = hn::Max(hn::Abs(inverse_low), hn::Abs(inverse_high));
    const auto tiny = hn::Ge(greatest, hn::Set(d4, 1 / kLeastComponent));
    // As a ray's own: more than the roundings of the test, and than a component that counts as 0 leads astray.
    hn::Store(hn::MulAdd(hn::Set(d4, reach * 0x1p-20f), greatest, hn::IfThenElseZero(tiny, hn::Set(d4, 4 * reach))), d4,
              pad_);
    const double t_scale = setup.TScale(exponent_);
    least_t_min_ = std::max(static_cast<float>(lows[3] * t_scale), -2 * reach);
    SetLimit(std::min(static_cast<float>(highs[7] * t_scale), 2 * reach));
    return true;
  }

  // The boxes of a node that some ray may enter within its range, and no ray earlier than when.
  HWY_ATTR HWY_INLINE NodeHits Test(const std::byte* node) const {
    const DNode d;
    const auto face = [&](int axis, uint32_t upper) HWY_ATTR {
      return hn::Load(d, reinterpret_cast<const float*>(node + 2 * axis * kUnitBytes + upper));
    };
    hn::Vec<DNode> near = hn::Set(d, least_t_min_), far = hn::Set(d, greatest_limit_);
    for (int axis = 0; axis < 3; ++axis) {
      const hn::Vec<DNode> low = hn::Set(d, inverse_low_[axis]), high = hn::Set(d, inverse_high_[axis]);
      const hn::Vec<DNode> to_near = hn::Sub(face(axis, flip_[axis]), hn::Set(d, near_origin_[axis]));
      const hn::Vec<DNode> to_far = hn::Sub(face(axis, kUnitBytes - flip_[axis]), hn::Set(d, far_origin_[axis]));
      const hn::Vec<DNode> pad = hn::Set(d, pad_[axis]);
      near = hn::Max(near, hn::Sub(hn::Min(hn::Mul(to_near, low), hn::Mul(to_near, high)), pad));
      far = hn::Min(far, hn::Add(hn::Max(hn::Mul(to_far, low), hn::Mul(to_far, high)), pad));
    }
    return {hn::Le(near, far), near};
  }

  // Bytes from an axis' lower faces to those that are near for all rays.
  uint32_t flip(int axis) const { return flip_[axis]; }
  // The exponent of their directions; see RaySetup.
  int exponent() const { return exponent_; }
  // No hit of any ray beyond it matters.
  void SetLimit(float limit) {
    greatest_limit_ = limit;
    limit_key_ = LimitKey(limit);
  }
  int32_t limit_key() const { return limit_key_; }

 private:
  // For most packets that start too far apart, the first ray and the last one tell.
  HWY_ATTR static bool StartApart(const Ray& a, const Ray& b, const Setup& setup) {
    const D4 d;
    const V4 apart = hn::Abs(hn::Sub(hn::LoadU(d, &a.origin.x), hn::LoadU(d, &b.origin.x)));
    const V4 most = hn::Set(d, static_cast<float>(kWidestStart / setup.scale()));
    return !hn::AllFalse(d, hn::And(hn::FirstN(d, 3), hn::Ge(apart, most)));
  }

  static constexpr float kWidestPacket = 0.25f, kWidestStart = 0x1p-9f;

  int exponent_ = 0;
  HWY_ALIGN uint32_t flip_[4];
  HWY_ALIGN float near_origin_[4], far_origin_[4], inverse_low_[4], inverse_high_[4], pad_[4];
  float least_t_min_ = 0, greatest_limit_ = 0;
  int32_t limit_key_ = 0;
};

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_PACKET_BOUNDS_INL_H_
