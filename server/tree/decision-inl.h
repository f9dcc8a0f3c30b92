// The end of exact closest hits, many at a time: whether the one triangle that is left is hit, and where.

#if defined(SERVER_TREE_DECISION_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_DECISION_INL_H_
#undef SERVER_TREE_DECISION_INL_H_
#else
#define SERVER_TREE_DECISION_INL_H_
#endif

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>

#include "hwy/highway.h"
#include "server/geometry/ray.h"
#include "server/tree/leaf_test-inl.h"
#include "server/tree/suspects.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

// A queue of rays with one suspect each. What server/geometry/triangle_test.h does for one ray and triangle is done
// here for a register of them, by the same formulas and bounds; what it could not tell either, is handed to it.
class DecisionQueue {
  using D = hn::ScalableTag<double>;
  using V = hn::Vec<D>;
  using M = hn::Mask<D>;

 public:
  DecisionQueue(const WideScene& scene, std::span<const Ray> rays, Culling culling, ClosestDecider& decider,
                std::span<Hit> hits)
      : base_(scene.arrays.block.data()), rays_(rays), culling_(culling), decider_(decider), hits_(hits) {}

  // REQUIRES: ray.exact, one suspect.
  HWY_ATTR void Add(const RaySlot& ray) {
    const ChildRef leaf(ray.suspects[0].leaf);
    const LeafView view{reinterpret_cast<const float*>(base_ + leaf.offset() * UnitBytes(kWidth)), leaf.triangles()};
    const uint32_t lane = ray.suspects[0].lane;
    for (int i = 0; i < 9; ++i) corners_[i][size_] = view.columns[i * view.count + lane];
    for (int axis = 0; axis < 3; ++axis) {
      origin_[axis][size_] = ray.origin[axis];
      direction_[axis][size_] = ray.direction[axis];
    }
    // In the frame; beyond kFarthestEnd lies no hit.
    const Ray& given = rays_[ray.ray];
    ends_[0][size_] = std::clamp(given.t_min / ray.t_unscale, -kFarthestEnd, kFarthestEnd);
    ends_[1][size_] = std::clamp(given.t_max / ray.t_unscale, -kFarthestEnd, kFarthestEnd);
    unscale_[size_] = ray.t_unscale;
    ray_[size_] = ray.ray;
    primitive_[size_] = view.Primitive(lane);
    if (++size_ == kQueued) Flush();
  }

  // Writes the hits of all rays in the queue.
  HWY_ATTR void Flush() {
    for (size_t first = 0; first < size_; first += hn::MaxLanes(D())) {
      Decide(first, std::min(size_ - first, hn::MaxLanes(D())));
    }
    size_ = 0;
  }

 private:
  static constexpr size_t kQueued = 8;
  // 16 times as far as an origin may be.
  static constexpr double kFarthestEnd = 0x1p44;

  struct Vec {
    V x, y, z;
  };
  // A value and the bound of its error.
  struct Approximate {
    V value, error;
  };

  HWY_ATTR static HWY_INLINE Vec Minus(Vec a, Vec b) {
    return {hn::Sub(a.x, b.x), hn::Sub(a.y, b.y), hn::Sub(a.z, b.z)};
  }
  HWY_ATTR static HWY_INLINE Vec Abs(Vec a) { return {hn::Abs(a.x), hn::Abs(a.y), hn::Abs(a.z)}; }
  HWY_ATTR static HWY_INLINE V Dot(Vec a, Vec b) {
    return hn::Add(hn::Add(hn::Mul(a.x, b.x), hn::Mul(a.y, b.y)), hn::Mul(a.z, b.z));
  }
  HWY_ATTR static HWY_INLINE Vec Cross(Vec a, Vec b) {
    return {hn::Sub(hn::Mul(a.y, b.z), hn::Mul(a.z, b.y)), hn::Sub(hn::Mul(a.z, b.x), hn::Mul(a.x, b.z)),
            hn::Sub(hn::Mul(a.x, b.y), hn::Mul(a.y, b.x))};
  }
  HWY_ATTR static HWY_INLINE Vec CrossPermanent(Vec a, Vec b) {
    return {hn::Add(hn::Mul(a.y, b.z), hn::Mul(a.z, b.y)), hn::Add(hn::Mul(a.z, b.x), hn::Mul(a.x, b.z)),
            hn::Add(hn::Mul(a.x, b.y), hn::Mul(a.y, b.x))};
  }
  HWY_ATTR static HWY_INLINE M IsPositive(Approximate a) { return hn::Gt(a.value, a.error); }
  HWY_ATTR static HWY_INLINE M IsNegative(Approximate a) { return hn::Lt(a.value, hn::Neg(a.error)); }
  HWY_ATTR static HWY_INLINE M IsUncertain(Approximate a) {
    return hn::And(hn::Le(hn::Abs(a.value), a.error), hn::Ne(a.error, hn::Zero(D())));
  }

  HWY_ATTR HWY_INLINE Vec Load(const double (*columns)[kQueued], size_t first) const {
    const D d;
    return {hn::LoadU(d, columns[0] + first), hn::LoadU(d, columns[1] + first), hn::LoadU(d, columns[2] + first)};
  }

  // numerator / denominator * scale, a power of two, rounded to float; clears lanes of `certain` where that is not
  // certain.
  HWY_ATTR static HWY_INLINE void Round(Approximate numerator, Approximate denominator, V scale, float* out,
                                        M* certain) {
    const D d;
    const hn::Rebind<float, D> df;
    const V value = hn::Div(numerator.value, denominator.value);
    const V error = hn::Div(hn::Add(numerator.error, hn::Mul(hn::Abs(value), denominator.error)),
                            hn::Sub(hn::Abs(denominator.value), denominator.error));
    const V bound = hn::Add(hn::Mul(hn::Set(d, 1.001), error), hn::Mul(hn::Set(d, 0x1p-51), hn::Abs(value)));
    const auto lower = hn::DemoteTo(df, hn::Mul(hn::Sub(value, bound), scale));
    const auto upper = hn::DemoteTo(df, hn::Mul(hn::Add(value, bound), scale));
    // Makes -0 to +0.
    hn::StoreU(hn::Add(lower, hn::Zero(df)), df, out);
    *certain = hn::And(*certain, hn::Eq(hn::PromoteTo(d, lower), hn::PromoteTo(d, upper)));
  }

  HWY_ATTR HWY_INLINE void Decide(size_t first, size_t count) {
    const D d;
    // 1. Möller-Trumbore; see server/geometry/README.md.
    const V unit = hn::Set(d, 10 * 0x1p-53);
    const Vec v0 = Load(corners_, first), e1 = Minus(Load(corners_ + 3, first), v0),
              e2 = Minus(Load(corners_ + 6, first), v0);
    const Vec direction = Load(direction_, first), s = Minus(Load(origin_, first), v0);
    const Vec p = Cross(direction, e2), q = Cross(s, e1);
    const Vec abs_e1 = Abs(e1), abs_e2 = Abs(e2), abs_s = Abs(s), abs_d = Abs(direction);
    const Vec p_permanent = CrossPermanent(abs_d, abs_e2), q_permanent = CrossPermanent(abs_s, abs_e1);
    const V det_permanent = Dot(abs_e1, p_permanent), u_permanent = Dot(abs_s, p_permanent);
    const V v_permanent = Dot(abs_d, q_permanent), t_permanent = Dot(abs_e2, q_permanent);
    const Approximate det{Dot(e1, p), hn::Mul(unit, det_permanent)};
    const Approximate u{Dot(s, p), hn::Mul(unit, u_permanent)};
    const Approximate v{Dot(direction, q), hn::Mul(unit, v_permanent)};
    const Approximate w{hn::Sub(hn::Sub(det.value, u.value), v.value),
                        hn::Mul(unit, hn::Add(hn::Add(det_permanent, u_permanent), v_permanent))};
    const Approximate t{Dot(e2, q), hn::Mul(unit, t_permanent)};

    // 2. Which lanes are certain, and which of these are hits.
    const M positive = hn::Or(hn::Or(IsPositive(det), IsPositive(u)), hn::Or(IsPositive(v), IsPositive(w)));
    const M negative = hn::Or(hn::Or(IsNegative(det), IsNegative(u)), hn::Or(IsNegative(v), IsNegative(w)));
    M missed = hn::Or(hn::And(positive, negative), hn::Eq(det_permanent, hn::Zero(d)));
    M uncertain = hn::Or(hn::Or(IsUncertain(det), IsUncertain(u)), hn::Or(IsUncertain(v), IsUncertain(w)));
    const M back = hn::Lt(det.value, hn::Zero(d));
    const V sign = hn::And(det.value, hn::SignBit(d));
    for (int end = 0; end < 2; ++end) {
      const V at = hn::LoadU(d, ends_[end] + first);
      const V beyond = hn::Xor(hn::Sub(t.value, hn::Mul(at, det.value)), sign);
      const Approximate inside{end == 0 ? beyond : hn::Neg(beyond),
                               hn::Mul(unit, hn::Add(t_permanent, hn::Mul(hn::Abs(at), det_permanent)))};
      missed = hn::Or(missed, hn::AndNot(IsUncertain(det), IsNegative(inside)));
      uncertain = hn::Or(uncertain, IsUncertain(inside));
    }
    if (culling_ != Culling::kNone) {
      const M culled = culling_ == Culling::kBack ? back : hn::Not(back);
      missed = hn::Or(missed, hn::AndNot(IsUncertain(det), culled));
    }
    M certain = hn::Not(hn::Or(uncertain, missed));

    // 3. Round; lanes of which that can not be told, are decided one by one.
    float rounded[3][hn::MaxLanes(D())];
    Round(t, det, hn::LoadU(d, unscale_ + first), rounded[0], &certain);
    Round(u, det, hn::Set(d, 1.0), rounded[1], &certain);
    Round(v, det, hn::Set(d, 1.0), rounded[2], &certain);
    const uint32_t hit_bits = Bits(certain), missed_bits = Bits(missed), back_bits = Bits(back);
    for (size_t i = 0; i < count; ++i) {
      Hit& hit = hits_[ray_[first + i]];
      if (hit_bits >> i & 1) {
        hit = {.t = rounded[0][i],
               .u = rounded[1][i],
               .v = rounded[2][i],
               .primitive = primitive_[first + i],
               .back = (back_bits >> i & 1) != 0};
      } else if (missed_bits >> i & 1) {
        hit = Hit();
      } else {
        decider_.DecideOne(ray_[first + i], primitive_[first + i]);
      }
    }
  }

  HWY_ATTR static HWY_INLINE uint32_t Bits(M mask) {
    uint8_t bits[8] = {};
    hn::StoreMaskBits(D(), mask, bits);
    return bits[0];
  }

  const std::byte* const base_;
  const std::span<const Ray> rays_;
  const Culling culling_;
  ClosestDecider& decider_;
  const std::span<Hit> hits_;

  size_t size_ = 0;
  HWY_ALIGN double corners_[9][kQueued] = {};
  HWY_ALIGN double origin_[3][kQueued] = {};
  HWY_ALIGN double direction_[3][kQueued] = {};
  HWY_ALIGN double ends_[2][kQueued] = {};
  HWY_ALIGN double unscale_[kQueued] = {};
  uint32_t ray_[kQueued] = {};
  uint32_t primitive_[kQueued] = {};
};

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_DECISION_INL_H_
