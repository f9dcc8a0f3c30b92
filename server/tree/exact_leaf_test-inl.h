// The leaf test at the exact level: which triangles a ray may hit.

#if defined(SERVER_TREE_EXACT_LEAF_TEST_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_EXACT_LEAF_TEST_INL_H_
#undef SERVER_TREE_EXACT_LEAF_TEST_INL_H_
#else
#define SERVER_TREE_EXACT_LEAF_TEST_INL_H_
#endif

#include <cstddef>

#include "hwy/highway.h"
#include "server/geometry/ray.h"
#include "server/tree/leaf_lanes-inl.h"
#include "server/tree/leaf_test-inl.h"
#include "server/tree/ray_slot.h"
#include "server/tree/wide_node.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

// Lanes that may be hits, with a lower bound of t. No hit of the lane's ray beyond certain_limit matters.
template <class D>
struct LeafSuspects {
  hn::Mask<D> mask;
  hn::Vec<D> t, certain_limit;
};

// AccuracyLevel::kExact, first stage: keeps all triangles that the ray may hit. Each value is known within its slack;
// README.md derives them.
struct ExactTest {
  static constexpr bool kExact = true;

  HWY_ATTR static void SetUp(RaySlot&) {}
  HWY_ATTR static void SetUp(RayColumns&) {}

  // What the first step hands on is kept for every leaf, so that it is little; the second one works the rest out again.
  template <class D>
  struct First {
    hn::Vec<D> det, u, v, t;  // turned so that the determinant counts as positive
    hn::Vec<D> sign;
    hn::Vec<D> far;  // the first corner's distance from the ray's origin along the farthest axis
    hn::Mask<D> mask;
  };

  template <typename Rays, typename Triangles, class D = typename Rays::D>
  HWY_ATTR static HWY_INLINE First<D> Start(const Rays& rays, const Triangles& triangles) {
    using V = hn::Vec<D>;
    using M = hn::Mask<D>;
    const D d;
    const MollerTrumbore<D> test(rays, triangles);
    First<D> result;
    result.sign = test.sign;
    result.det = test.det, result.u = test.u, result.v = test.v, result.t = test.t;
    result.far = hn::Max(hn::Max(hn::Abs(test.sx), hn::Abs(test.sy)), hn::Abs(test.sz));

    // Certainly beside the triangle, whether or not the determinant has a certain sign.
    const Slack<D> slack(rays, triangles, result.far);
    const V w = hn::Sub(hn::Sub(result.det, result.u), result.v);
    const V most_outside = hn::Neg(hn::Min(hn::Min(result.u, result.v), w));
    const M sure = hn::Gt(result.det, slack.det);
    const M beside = hn::Gt(most_outside, slack.edge);
    const M far_beside = hn::Gt(hn::Mul(most_outside, hn::Set(d, 0.25f)), slack.edge);
    const Ends<D> ends(rays, result, slack);
    const M out = hn::Or(far_beside, hn::And(sure, hn::Or(beside, ends.outside())));
    result.mask = hn::AndNot(out, triangles.Valid());
    return result;
  }

  template <typename Rays, typename Triangles, class D = typename Rays::D>
  HWY_ATTR static HWY_INLINE LeafSuspects<D> Finish(const Rays& rays, const Triangles& triangles, const First<D>& start,
                                                    Culling culling) {
    using V = hn::Vec<D>;
    using M = hn::Mask<D>;
    const D d;
    const V det = start.det, t = start.t;
    const Slack<D> slack(rays, triangles, start.far);
    const V t_slack = slack.t;
    const M sure = hn::Gt(det, slack.det);
    // 1. Culled for certain, excluded, or certainly out of the interval.
    LeafSuspects<D> suspects;
    const M culled = hn::Not(NotCulled(d, culling, IsNegative(d, start.sign)));
    const hn::RebindToUnsigned<D> du;
    const auto ids = hn::And(triangles.Ids(), hn::Set(du, kPrimitiveMask));
    const M excluded = hn::RebindMask(d, hn::Eq(ids, rays.Excluded()));
    suspects.mask = hn::AndNot(hn::Or(excluded, hn::And(sure, culled)), start.mask);

    // 2. Bounds of t: (T -+ slack) / (det +- slack), and the roundings of that.
    const V t_low = hn::Sub(t, t_slack), t_high = hn::Add(t, t_slack);
    const V det_low = hn::Sub(det, slack.det), det_high = hn::Add(det, slack.det);
    const V zero = hn::Zero(d), down = hn::Set(d, 1 - 0x1p-21f), up = hn::Set(d, 1 + 0x1p-21f);
    const M low_negative = hn::Lt(t_low, zero), high_negative = hn::Lt(t_high, zero);
    const V lower = hn::Mul(hn::Div(t_low, hn::IfThenElse(low_negative, det_low, det_high)),
                            hn::IfThenElse(low_negative, up, down));
    const V upper = hn::Mul(hn::Div(t_high, hn::IfThenElse(high_negative, det_high, det_low)),
                            hn::IfThenElse(high_negative, down, up));
    suspects.t = hn::IfThenElse(sure, lower, hn::Set(d, -hwy::HighestValue<float>()));

    // 3. Hits for certain.
    const V w = hn::Sub(hn::Sub(det, start.u), start.v);
    const M inside = hn::And(sure, hn::Gt(hn::Min(hn::Min(start.u, start.v), w), slack.edge));
    const Ends<D> ends(rays, start, slack);
    const M certain = hn::And(suspects.mask, hn::And(inside, ends.within()));
    suspects.certain_limit = hn::IfThenElse(certain, upper, rays.Limit());
    return suspects;
  }

 private:
  // What the low end of float costs T, in L²: where `far` is subnormal, or nearly, no factor of it would do.
  static constexpr float kLeastFar = 0x1p-85f;

  // Error bounds: (far + L / 2) L of U, V, W, with a factor; L² of the determinant, with another; and far L² of T.
  template <class D>
  struct Slack {
    using V = hn::Vec<D>;
    V det, edge, t;
    V size2, t_factor;

    template <typename Rays, typename Triangles>
    HWY_ATTR HWY_INLINE Slack(const Rays& rays, const Triangles& triangles, V far) {
      const D d;
      const V size = SizesOf(d, triangles.Ids());
      size2 = hn::Mul(size, size);
      det = hn::Mul(rays.DetSlack(), size2);
      edge = hn::Mul(hn::Mul(rays.EdgeSlack(), size), hn::MulAdd(hn::Set(d, 0.5f), size, far));
      t_factor = hn::MulAdd(hn::Set(d, 60 * 0x1p-24f), far, hn::Set(d, kLeastFar));
      t = hn::Mul(t_factor, size2);
    }
  };

  // How far t is outside of the ends of the interval, times the determinant, where its sign is certain; and how far off
  // that may be.
  template <class D>
  struct Ends {
    using V = hn::Vec<D>;
    V before, beyond, before_slack, beyond_slack;

    template <typename Rays>
    HWY_ATTR HWY_INLINE Ends(const Rays& rays, const First<D>& test, const Slack<D>& slack) {
      const V t_min = rays.TMin(), limit = rays.Limit();
      before = hn::MulSub(t_min, test.det, test.t);
      beyond = hn::NegMulAdd(limit, test.det, test.t);
      before_slack = EndSlack(rays, t_min, slack), beyond_slack = EndSlack(rays, limit, slack);
    }

    HWY_ATTR HWY_INLINE hn::Mask<D> outside() const {
      return hn::Or(hn::Gt(before, before_slack), hn::Gt(beyond, beyond_slack));
    }
    HWY_ATTR HWY_INLINE hn::Mask<D> within() const {
      return hn::And(hn::Lt(before, hn::Neg(before_slack)), hn::Lt(beyond, hn::Neg(beyond_slack)));
    }

    // The error bound of T - end * det.
    template <typename Rays>
    HWY_ATTR static HWY_INLINE V EndSlack(const Rays& rays, V end, const Slack<D>& slack) {
      return hn::Mul(hn::MulAdd(rays.EndSlack(), hn::Abs(end), slack.t_factor), slack.size2);
    }
  };
};

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_EXACT_LEAF_TEST_INL_H_
