// The end of exact closest hits, several at a time: which of the triangles that are left is hit, and where.

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
#include "server/tree/leaf_lanes-inl.h"
#include "server/tree/suspects.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

// What server/geometry/triangle_test.h does for one ray and triangle is done here for registers of them, by the same
// formulas and bounds: for the suspects of one ray, to see which is hit first; and for a queue of rays with one suspect
// each, to see where. What it could not tell either, is handed to it.
class DecisionQueue {
  using D = hn::ScalableTag<double>;
  using V = hn::Vec<D>;
  using M = hn::Mask<D>;

 public:
  DecisionQueue(const WideScene& scene, std::span<const Ray> rays, Culling culling, ClosestDecider& decider,
                std::span<Hit> hits)
      : base_(scene.arrays.block.data()), rays_(rays), culling_(culling), decider_(decider), hits_(hits) {}

  // Drops suspects that are missed for certain, or farther for certain than one that is hit for certain.
  // REQUIRES: ray.exact.
  HWY_ATTR void Narrow(RaySlot& ray) {
    const uint32_t count = ray.suspect_count;
    for (uint32_t i = 0; i < count; ++i) {
      several_.Put(i, ray, rays_[ray.ray], ViewOf(ray.suspects[i]), ray.suspects[i].lane);
    }
    const D d;
    uint32_t missed = 0, hit = 0;
    double lower[kPairs], upper[kPairs];
    for (uint32_t i = 0; i < count; i += hn::MaxLanes(d)) {
      const Test test(several_, i, culling_);
      const Interval t(test.t, Divisor(test.det));
      hn::StoreU(t.lower, d, lower + i);
      hn::StoreU(t.upper, d, upper + i);
      missed |= Bits(test.missed) << i;
      hit |= Bits(hn::Not(hn::Or(test.missed, test.uncertain))) << i;
    }
    double limit = kFarthestEnd;
    for (uint32_t i = 0; i < count; ++i) {
      if (hit >> i & 1) limit = std::min(limit, upper[i]);
    }
    ray.suspect_count = 0;
    for (uint32_t i = 0; i < count; ++i) {
      const bool farther = (hit >> i & 1) != 0 && lower[i] > limit;
      if ((missed >> i & 1) == 0 && !farther) ray.suspects[ray.suspect_count++] = ray.suspects[i];
    }
  }

  // REQUIRES: ray.exact, one suspect.
  HWY_ATTR void Add(const RaySlot& ray) {
    const LeafView leaf = ViewOf(ray.suspects[0]);
    const uint32_t lane = ray.suspects[0].lane;
    queued_.Put(size_, ray, rays_[ray.ray], leaf, lane);
    ray_[size_] = ray.ray;
    primitive_[size_] = leaf.Primitive(lane);
    if (++size_ == kPairs) Flush();
  }

  // Writes the hits of all rays in the queue.
  HWY_ATTR void Flush() {
    for (size_t first = 0; first < size_; first += hn::MaxLanes(D())) {
      Decide(first, std::min(size_ - first, hn::MaxLanes(D())));
    }
    size_ = 0;
  }

 private:
  // As many as suspects of a ray, and a whole number of registers.
  static constexpr size_t kPairs = 8;
  static_assert(kPairs >= RaySlot::kMaxSuspects && kPairs % hn::MaxLanes(D()) == 0);
  // Far beyond any t in the frame.
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

  // Rays and triangles, in the tree's frame, as the floats that they are there.
  struct Pairs {
    HWY_ALIGN float corners[9][kPairs] = {};
    HWY_ALIGN float origin[3][kPairs] = {};
    HWY_ALIGN float direction[3][kPairs] = {};
    HWY_ALIGN float ends[2][kPairs] = {};  // the ray's own
    HWY_ALIGN double unscale[kPairs] = {};

    HWY_ATTR HWY_INLINE void Put(size_t at, const RaySlot& ray, const Ray& given, const LeafView& leaf, uint32_t lane) {
      for (int i = 0; i < 9; ++i) corners[i][at] = leaf.columns[i * leaf.count + lane];
      for (int axis = 0; axis < 3; ++axis) {
        origin[axis][at] = ray.origin[axis];
        direction[axis][at] = ray.direction[axis];
      }
      ends[0][at] = given.t_min;
      ends[1][at] = given.t_max;
      unscale[at] = ray.t_unscale;
    }

    HWY_ATTR static HWY_INLINE V Load(const float* column) {
      const D d;
      return hn::PromoteTo(d, hn::LoadU(hn::Rebind<float, D>(), column));
    }
    HWY_ATTR static HWY_INLINE Vec Load(const float (*columns)[kPairs], size_t first) {
      return {Load(columns[0] + first), Load(columns[1] + first), Load(columns[2] + first)};
    }
  };

  // Möller-Trumbore of some pairs; see server/geometry/README.md. A lane that is neither missed nor uncertain is hit.
  struct Test {
    Approximate det, u, v, t;
    M back, missed, uncertain;

    HWY_ATTR HWY_INLINE Test(const Pairs& pairs, size_t first, Culling culling) {
      const D d;
      const V unit = hn::Set(d, 10 * 0x1p-53);
      const Vec v0 = Pairs::Load(pairs.corners, first), e1 = Minus(Pairs::Load(pairs.corners + 3, first), v0),
                e2 = Minus(Pairs::Load(pairs.corners + 6, first), v0);
      const Vec direction = Pairs::Load(pairs.direction, first), s = Minus(Pairs::Load(pairs.origin, first), v0);
      const Vec p = Cross(direction, e2), q = Cross(s, e1);
      const Vec abs_e1 = Abs(e1), abs_e2 = Abs(e2), abs_s = Abs(s), abs_d = Abs(direction);
      const Vec p_permanent = CrossPermanent(abs_d, abs_e2), q_permanent = CrossPermanent(abs_s, abs_e1);
      const V det_permanent = Dot(abs_e1, p_permanent), u_permanent = Dot(abs_s, p_permanent);
      const V v_permanent = Dot(abs_d, q_permanent), t_permanent = Dot(abs_e2, q_permanent);
      det = {Dot(e1, p), hn::Mul(unit, det_permanent)};
      u = {Dot(s, p), hn::Mul(unit, u_permanent)};
      v = {Dot(direction, q), hn::Mul(unit, v_permanent)};
      t = {Dot(e2, q), hn::Mul(unit, t_permanent)};
      const Approximate w{hn::Sub(hn::Sub(det.value, u.value), v.value),
                          hn::Mul(unit, hn::Add(hn::Add(det_permanent, u_permanent), v_permanent))};

      const M positive = hn::Or(hn::Or(IsPositive(det), IsPositive(u)), hn::Or(IsPositive(v), IsPositive(w)));
      const M negative = hn::Or(hn::Or(IsNegative(det), IsNegative(u)), hn::Or(IsNegative(v), IsNegative(w)));
      missed = hn::Or(hn::And(positive, negative), hn::Eq(det_permanent, hn::Zero(d)));
      uncertain = hn::Or(hn::Or(IsUncertain(det), IsUncertain(u)), hn::Or(IsUncertain(v), IsUncertain(w)));
      back = hn::Lt(det.value, hn::Zero(d));
      const V sign = hn::And(det.value, hn::SignBit(d));
      // Of a power of two, and so exact.
      const V scale = hn::Div(hn::Set(d, 1.0), hn::LoadU(d, pairs.unscale + first));
      for (int end = 0; end < 2; ++end) {
        // Beyond kFarthestEnd lies no hit.
        const V scaled = hn::Mul(Pairs::Load(pairs.ends[end] + first), scale);
        const V at = hn::Clamp(scaled, hn::Set(d, -kFarthestEnd), hn::Set(d, kFarthestEnd));
        const V beyond = hn::Xor(hn::Sub(t.value, hn::Mul(at, det.value)), sign);
        const Approximate inside{end == 0 ? beyond : hn::Neg(beyond),
                                 hn::Mul(unit, hn::Add(t_permanent, hn::Mul(hn::Abs(at), det_permanent)))};
        missed = hn::Or(missed, hn::AndNot(IsUncertain(det), IsNegative(inside)));
        uncertain = hn::Or(uncertain, IsUncertain(inside));
      }
      if (culling != Culling::kNone) {
        const M culled = culling == Culling::kBack ? back : hn::Not(back);
        missed = hn::Or(missed, hn::AndNot(IsUncertain(det), culled));
      }
    }
  };

  // What divides the pairs' values by their determinants, where the sign of these is certain.
  struct Divisor {
    V det_error, inverse, inverse_least;  // of the determinant, and of its least magnitude

    HWY_ATTR HWY_INLINE explicit Divisor(Approximate det) {
      const D d;
      const V one = hn::Set(d, 1.0);
      det_error = det.error;
      inverse = hn::Div(one, det.value);
      inverse_least = hn::Div(one, hn::Sub(hn::Abs(det.value), det.error));
    }
  };

  // What a quotient is between. Its roundings, and those of the bounds, are at most 2^-53 of it each, three in all; the
  // few of the error, 1.001 makes up for.
  struct Interval {
    V lower, upper;

    HWY_ATTR HWY_INLINE Interval(Approximate numerator, const Divisor& divisor) {
      const D d;
      const V value = hn::Mul(numerator.value, divisor.inverse);
      const V error =
          hn::Mul(hn::Add(numerator.error, hn::Mul(hn::Abs(value), divisor.det_error)), divisor.inverse_least);
      const V bound = hn::Add(hn::Mul(hn::Set(d, 1.001), error), hn::Mul(hn::Set(d, 0x1p-51), hn::Abs(value)));
      lower = hn::Sub(value, bound);
      upper = hn::Add(value, bound);
    }
  };

  // What is between these bounds, times scale, a power of two, rounded to float; clears lanes of `certain` where that
  // is not certain.
  HWY_ATTR static HWY_INLINE void Round(const Interval& interval, V scale, float* out, M* certain) {
    const D d;
    const hn::Rebind<float, D> df;
    const auto lower = hn::DemoteTo(df, hn::Mul(interval.lower, scale));
    const auto upper = hn::DemoteTo(df, hn::Mul(interval.upper, scale));
    // Makes -0 to +0.
    hn::StoreU(hn::Add(lower, hn::Zero(df)), df, out);
    *certain = hn::And(*certain, hn::Eq(hn::PromoteTo(d, lower), hn::PromoteTo(d, upper)));
  }

  HWY_ATTR HWY_INLINE void Decide(size_t first, size_t count) {
    const D d;
    const Test test(queued_, first, culling_);
    M certain = hn::Not(hn::Or(test.uncertain, test.missed));
    // Lanes of which the rounded numbers cannot be told, are decided one by one.
    float rounded[3][hn::MaxLanes(D())];
    const Divisor divisor(test.det);
    Round(Interval(test.t, divisor), hn::LoadU(d, queued_.unscale + first), rounded[0], &certain);
    Round(Interval(test.u, divisor), hn::Set(d, 1.0), rounded[1], &certain);
    Round(Interval(test.v, divisor), hn::Set(d, 1.0), rounded[2], &certain);
    const uint32_t hit_bits = Bits(certain), missed_bits = Bits(test.missed), back_bits = Bits(test.back);
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

  HWY_ATTR HWY_INLINE LeafView ViewOf(const Suspect& suspect) const {
    const ChildRef leaf(suspect.leaf);
    return {reinterpret_cast<const float*>(base_ + leaf.offset() * UnitBytes(kWidth)), leaf.triangles()};
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

  Pairs queued_, several_;
  size_t size_ = 0;  // of queued_
  uint32_t ray_[kPairs] = {};
  uint32_t primitive_[kPairs] = {};
};

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_DECISION_INL_H_
