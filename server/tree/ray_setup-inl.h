// A ray into the frame of a wide tree.

#if defined(SERVER_TREE_RAY_SETUP_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_RAY_SETUP_INL_H_
#undef SERVER_TREE_RAY_SETUP_INL_H_
#else
#define SERVER_TREE_RAY_SETUP_INL_H_
#endif

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>

#include "hwy/highway.h"
#include "server/geometry/ray.h"
#include "server/tree/node_test-inl.h"
#include "server/tree/ray_slot.h"
#include "server/tree/wide_arrays.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

// Directions' components below this count as 0; see README.md.
constexpr float kLeastComponent = 0x1p-80f;
// Origins farther out than this many sizes of the mesh are odd: float's boxes are padded by so much then that tracing
// in double, ray by ray, is as fast. From 2^21 on they would hold back nothing.
constexpr float kFarthestOrigin = 0x1p11f;

// Lowers the limit of a ray, or sets it.
HWY_ATTR HWY_INLINE void SetLimit(RaySlot& slot, float limit) {
  slot.limit = limit;
  slot.limit_key = LimitKey(limit);
}

// Makes RaySlots of rays. `kExact`: for leaf tests at kExact, which need more.
template <bool kExact>
class RaySetup {
  // x, y, z of one ray, and a fourth lane that is not used or holds an end of the interval.
  using DF = hn::FixedTag<float, 4>;
  using DU = hn::RebindToUnsigned<DF>;
  using VF = hn::Vec<DF>;

 public:
  enum class Kind : uint8_t { kTraced, kMisses, kOdd };

  explicit RaySetup(const WideArrays& arrays)
      : scale_exponent_(arrays.scale_exponent),
        scale_(PowerOfTwo(arrays.scale_exponent)),
        exact_corners_(arrays.exact_corners),
        flip_(static_cast<uint32_t>(UnitBytes(Width(arrays.target)))) {}

  // Fills all of `slot` that tests read, and empties its stack and its answer. Tells what to do with the ray.
  // PacketRays does the same for many.
  HWY_ATTR HWY_INLINE Kind Make(const Ray& ray, RaySlot& slot) const {
    const float greatest = Greatest(hn::LoadU(DF(), &ray.direction.x));
    // NaN counts as odd.
    if (HWY_UNLIKELY(!(greatest >= kLeastDirection && greatest < kGreatestDirection))) return Kind::kOdd;
    return MakeSized(ray, ExponentOf(greatest), slot);
  }

  // Directions of greater or smaller greatest components are odd: no normal float is the inverse power of two.
  static constexpr float kLeastDirection = 0x1p-126f, kGreatestDirection = 0x1p126f;

  // The exponent e of a positive normal number: 2^e is the greatest power of two up to it.
  static int ExponentOf(float x) { return static_cast<int>(std::bit_cast<uint32_t>(x) >> 23) - 127; }

  // What directions are scaled by, given that exponent.
  static float DirectionScale(int exponent) {
    return std::bit_cast<float>(static_cast<uint32_t>(127 - exponent) << 23);
  }
  // What t is scaled by.
  double TScale(int exponent) const { return PowerOfTwo(exponent + scale_exponent_); }
  // What the ray's t are, of those of the frame.
  double TUnscale(int exponent) const { return PowerOfTwo(-exponent - scale_exponent_); }
  // What coordinates are scaled by.
  double scale() const { return scale_; }
  bool exact_corners() const { return exact_corners_; }

  // The greatest magnitude of the first three lanes.
  HWY_ATTR static HWY_INLINE float Greatest(VF x) {
    const VF magnitude = hn::Abs(x);
    const VF yzx = hn::Max(magnitude, hn::Shuffle0321(magnitude));
    return hn::GetLane(hn::Max(yzx, hn::Shuffle1032(magnitude)));
  }

  // x times a power of two, which float may lack, rounded once.
  template <class V>
  HWY_ATTR static HWY_INLINE V Times(V x, double power) {
    const hn::DFromV<V> d;
    if (HWY_LIKELY(power > 0x1p-100 && power < 0x1p100)) return hn::Mul(x, hn::Set(d, static_cast<float>(power)));
    HWY_ALIGN float lanes[hn::MaxLanes(d)];
    hn::Store(x, d, lanes);
    for (float& lane : lanes) lane = static_cast<float>(lane * power);
    return hn::Load(d, lanes);
  }

  // Of directions' components; those that count as 0 have a finite one too.
  template <class V>
  HWY_ATTR static HWY_INLINE V Inverse(V direction) {
    const hn::DFromV<V> d;
    const auto tiny = hn::Lt(hn::Abs(direction), hn::Set(d, kLeastComponent));
    return hn::IfThenElse(tiny, hn::Set(d, 1 / kLeastComponent), hn::Div(hn::Set(d, 1.0f), direction));
  }

  // How much a slab's ends are set apart, with that inverse, for a ray of that reach.
  template <class V>
  HWY_ATTR static HWY_INLINE V Pad(V direction, V inverse, V reach) {
    const hn::DFromV<V> d;
    const auto tiny = hn::Lt(hn::Abs(direction), hn::Set(d, kLeastComponent));
    return hn::MulAdd(hn::Mul(reach, hn::Set(d, 0x1p-21f)), hn::Abs(inverse),
                      hn::IfThenElseZero(tiny, hn::Mul(hn::Set(d, 4.0f), reach)));
  }

  // Whether x, times a power of two, may have lost bits.
  template <class V>
  HWY_ATTR static HWY_INLINE hn::Mask<hn::DFromV<V>> MayHaveRounded(V x, V scaled) {
    const hn::DFromV<V> d;
    return hn::And(hn::Lt(hn::Abs(scaled), hn::Set(d, 0x1p-126f)), hn::Ne(x, hn::Zero(d)));
  }

  // Error bounds of the leaf test at kExact, for a direction of length 1; see README.md.
  static constexpr float kEdgeSlack = 40 * 0x1p-24f, kDetSlack = 16 * 0x1p-24f, kEndSlack = 20 * 0x1p-24f;

 private:
  // The same, where that is the exponent of the direction's greatest component, which 2^-exponent brings to [1, 2).
  HWY_ATTR HWY_INLINE Kind MakeSized(const Ray& ray, int exponent, RaySlot& slot) const {
    const DF d;
    const DU du;
    const auto xyz = hn::FirstN(d, 3);

    // 1. Scale.
    const VF given_direction = hn::LoadU(d, &ray.direction.x), given_origin = hn::LoadU(d, &ray.origin.x);
    const VF direction = hn::Mul(given_direction, hn::Set(d, DirectionScale(exponent)));
    const VF origin = Times(given_origin, scale_);
    const float farthest = Greatest(origin);
    if (HWY_UNLIKELY(!(farthest <= kFarthestOrigin))) return Kind::kOdd;
    // No point of the mesh is farther from the origin along any axis than `reach`; so no t in the mesh is beyond it.
    const float reach = farthest + 1;
    const double t_scale = TScale(exponent);
    slot.t_unscale = TUnscale(exponent);
    const float t_min = ScaledEnd(ray.t_min, t_scale), t_max = ScaledEnd(ray.t_max, t_scale);

    // 2. Slabs, widened; see README.md.
    const VF inverse = Inverse(direction);
    const VF centre = hn::Neg(hn::Mul(origin, inverse));
    const VF pad = Pad(direction, inverse, hn::Set(d, reach));
    hn::StoreU(inverse, d, slot.inverse);
    hn::StoreU(hn::Sub(centre, pad), d, slot.near_offset);
    hn::StoreU(hn::Add(centre, pad), d, slot.far_offset);
    const auto negative = hn::RebindMask(du, hn::Lt(inverse, hn::Zero(d)));
    hn::StoreU(hn::IfThenElseZero(negative, hn::Set(du, flip_)), du, slot.flip);
    hn::StoreU(origin, d, slot.origin);
    hn::StoreU(direction, d, slot.direction);
    slot.t_min = std::max(t_min, -2 * reach);
    slot.excluded = ray.excluded_primitive;
    slot.stack_size = 1;
    slot.primitive = kNoPrimitive;
    slot.suspect_count = 0;
    SetLimit(slot, std::min(t_max, 2 * reach));

    // 3. Error bounds of the leaf test at kExact; see README.md.
    if (!kExact) return slot.t_min <= slot.limit ? Kind::kTraced : Kind::kMisses;
    const float length = std::abs(slot.direction[0]) + std::abs(slot.direction[1]) + std::abs(slot.direction[2]);
    slot.edge_slack = kEdgeSlack * length;
    slot.det_slack = kDetSlack * length;
    slot.end_slack = kEndSlack * length;
    // Products with powers of two lose bits only below 2^-126.
    const auto rounded =
        hn::And(xyz, hn::Or(MayHaveRounded(given_direction, direction), MayHaveRounded(given_origin, origin)));
    slot.exact = exact_corners_ && hn::AllFalse(d, rounded) && !MayHaveRounded(ray.t_min, t_min) &&
                 !MayHaveRounded(ray.t_max, t_max);
    return slot.t_min <= slot.limit ? Kind::kTraced : Kind::kMisses;
  }

  static double PowerOfTwo(int exponent) { return std::bit_cast<double>(static_cast<uint64_t>(1023 + exponent) << 52); }

  static float ScaledEnd(float t, double scale) { return static_cast<float>(t * scale); }

  static bool MayHaveRounded(float x, float scaled) { return std::abs(scaled) < 0x1p-126f && x != 0; }

  const int scale_exponent_;
  const double scale_;
  const bool exact_corners_;
  const uint32_t flip_;
};

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_RAY_SETUP_INL_H_
