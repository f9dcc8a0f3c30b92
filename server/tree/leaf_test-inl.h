// A ray against all triangles of a leaf at once, or a triangle against many rays, at each level of accuracy.

#if defined(SERVER_TREE_LEAF_TEST_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_LEAF_TEST_INL_H_
#undef SERVER_TREE_LEAF_TEST_INL_H_
#else
#define SERVER_TREE_LEAF_TEST_INL_H_
#endif

#include <cmath>
#include <cstdint>

#include "hwy/highway.h"
#include "server/geometry/ray.h"
#include "server/tree/leaf_lanes-inl.h"
#include "server/tree/ray_slot.h"
#include "server/tree/wide_node.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

// Lanes that are hits, with t, u, v in the tree's frame.
template <class D>
struct LeafHits {
  hn::Mask<D> mask;
  hn::Vec<D> t, u, v;
  hn::Mask<D> back;
};

// Möller–Trumbore in float [Möller and Trumbore 1997]: t = T/det, u = U/det, v = V/det, all turned so that the
// determinant counts as positive.
template <class D>
struct MollerTrumbore {
  using V = hn::Vec<D>;
  V det, u, v, t;
  V sign;        // of the determinant
  V sx, sy, sz;  // from the first corner to the ray's origin

  template <typename Rays, typename Triangles>
  HWY_ATTR MollerTrumbore(const Rays& rays, const Triangles& triangles) {
    const V x0 = triangles.Corner(0, 0), y0 = triangles.Corner(0, 1), z0 = triangles.Corner(0, 2);
    const V e1x = hn::Sub(triangles.Corner(1, 0), x0), e2x = hn::Sub(triangles.Corner(2, 0), x0);
    const V e1y = hn::Sub(triangles.Corner(1, 1), y0), e2y = hn::Sub(triangles.Corner(2, 1), y0);
    const V e1z = hn::Sub(triangles.Corner(1, 2), z0), e2z = hn::Sub(triangles.Corner(2, 2), z0);
    const V dx = rays.Direction(0), dy = rays.Direction(1), dz = rays.Direction(2);
    sx = hn::Sub(rays.Origin(0), x0);
    sy = hn::Sub(rays.Origin(1), y0);
    sz = hn::Sub(rays.Origin(2), z0);
    const V px = Difference(dy, e2z, dz, e2y), py = Difference(dz, e2x, dx, e2z), pz = Difference(dx, e2y, dy, e2x);
    const V qx = Difference(sy, e1z, sz, e1y), qy = Difference(sz, e1x, sx, e1z), qz = Difference(sx, e1y, sy, e1x);
    det = Dot(e1x, e1y, e1z, px, py, pz);
    u = Dot(sx, sy, sz, px, py, pz);
    v = Dot(dx, dy, dz, qx, qy, qz);
    t = Dot(e2x, e2y, e2z, qx, qy, qz);
    sign = hn::And(det, hn::SignBit(D()));
    det = hn::Xor(det, sign), u = hn::Xor(u, sign), v = hn::Xor(v, sign), t = hn::Xor(t, sign);
  }

 private:
  HWY_ATTR static V Difference(V a, V b, V c, V d) { return hn::MulSub(a, b, hn::Mul(c, d)); }
  HWY_ATTR static V Dot(V ax, V ay, V az, V bx, V by, V bz) {
    return hn::MulAdd(ax, bx, hn::MulAdd(ay, by, hn::Mul(az, bz)));
  }
};

// Lanes of which the sign bit is set.
template <class D>
HWY_ATTR HWY_INLINE hn::Mask<D> IsNegative(D d, hn::Vec<D> x) {
  const hn::RebindToSigned<D> di;
  return hn::RebindMask(d, hn::Lt(hn::BitCast(di, x), hn::Zero(di)));
}

template <class D>
HWY_ATTR HWY_INLINE hn::Mask<D> NotCulled(D d, Culling culling, hn::Mask<D> back) {
  const hn::Mask<D> all = hn::FirstN(d, hn::MaxLanes(d));
  return culling == Culling::kNone ? all : culling == Culling::kBack ? hn::Not(back) : back;
}

// Each level is a test in two steps: the first one finds the lanes that may be hit, mostly none; the second one, which
// takes what the first one found out, is for the rare ones that are. `Rays` and `Triangles` are OneRay or OneOfRays and
// LeafLanes, or RayLanes and OneTriangle: the same operations on each pair, and so the same bits. SetUp works out what
// only this level needs of a ray, or of many.

// Determinants below this count as 0 in float: their inverses may be infinite, and infinity times 0 no number.
constexpr float kLeastDeterminant = 0x1p-126f;

// Whether t_times_det / det is in the interval, but for roundings. REQUIRES: det >= 0.
template <typename Rays, class D = typename Rays::D>
HWY_ATTR HWY_INLINE hn::Mask<D> MayBeInRange(const Rays& rays, hn::Vec<D> t_times_det, hn::Vec<D> det) {
  const hn::Vec<D> after = hn::NegMulAdd(rays.TMin(), det, t_times_det);
  const hn::Vec<D> before = hn::MulSub(rays.Limit(), det, t_times_det);
  return hn::Ge(hn::Min(after, before), hn::Zero(D()));
}

// Whether t as rounded is.
template <typename Rays, class D = typename Rays::D>
HWY_ATTR HWY_INLINE hn::Mask<D> IsInRange(const Rays& rays, hn::Vec<D> t) {
  return hn::And(hn::Ge(t, rays.TMin()), hn::Le(t, rays.Limit()));
}

// AccuracyLevel::kFast.
struct FastTest {
  static constexpr bool kExact = false;

  template <class D>
  struct First {
    hn::Vec<D> det, u, v, t;  // turned so that the determinant counts as positive
    hn::Vec<D> sign;
    hn::Mask<D> mask;
  };

  HWY_ATTR static void SetUp(RaySlot&) {}
  HWY_ATTR static void SetUp(RayColumns&) {}

  template <typename Rays, typename Triangles, class D = typename Rays::D>
  HWY_ATTR static HWY_INLINE First<D> Start(const Rays& rays, const Triangles& triangles) {
    using V = hn::Vec<D>;
    using M = hn::Mask<D>;
    const D d;
    const MollerTrumbore<D> test(rays, triangles);
    First<D> result;
    result.sign = test.sign;
    result.det = test.det, result.u = test.u, result.v = test.v, result.t = test.t;
    const V zero = hn::Zero(d);
    const M inside =
        hn::And(hn::Ge(hn::Min(result.u, result.v), zero), hn::Le(hn::Add(result.u, result.v), result.det));
    const M in_range = MayBeInRange(rays, result.t, result.det);
    const M large = hn::Ge(result.det, hn::Set(d, kLeastDeterminant));
    result.mask = hn::And(hn::And(inside, in_range), hn::And(large, triangles.Valid()));
    return result;
  }

  template <typename Rays, class D = typename Rays::D>
  HWY_ATTR static HWY_INLINE LeafHits<D> Finish(const Rays& rays, const First<D>& start, Culling culling) {
    const D d;
    const hn::Vec<D> inverse = hn::Div(hn::Set(d, 1.0f), start.det);
    LeafHits<D> hits;
    hits.t = hn::Mul(start.t, inverse), hits.u = hn::Mul(start.u, inverse), hits.v = hn::Mul(start.v, inverse);
    hits.back = IsNegative(d, start.sign);
    hits.mask = hn::And(hn::And(start.mask, IsInRange(rays, hits.t)), NotCulled(d, culling, hits.back));
    return hits;
  }
};

// AccuracyLevel::kWatertight: [Woop 2013]. The triangle is sheared so that the ray runs along the last axis through 0;
// its edges' functions there are computed from the same two corners in the same way for both triangles at an edge. A
// sign is never wrong: products are rounded before they are compared, not fused, and 0 counts as inside.
struct WatertightTest {
  static constexpr bool kExact = false;

  // Without branches: which axis comes last, and whether it is turned, cannot be foretold.
  HWY_ATTR static HWY_INLINE void SetUp(RaySlot& ray) {
    const float x = std::abs(ray.direction[0]), y = std::abs(ray.direction[1]), z = std::abs(ray.direction[2]);
    const uint32_t z_is = static_cast<uint32_t>(z >= x) & static_cast<uint32_t>(z >= y);
    const uint32_t last = 2 * z_is | (static_cast<uint32_t>(y > x) & ~z_is);
    constexpr uint32_t kNext[5] = {0, 1, 2, 0, 1};
    // Swaps the others where the last one is turned, which keeps the winding.
    const uint32_t turned = ray.direction[last] < 0;
    ray.axis[0] = kNext[last + 1 + turned];
    ray.axis[1] = kNext[last + 2 - turned];
    ray.axis[2] = last;
    ray.shear[2] = ray.inverse[last];
    ray.shear[0] = ray.direction[ray.axis[0]] * ray.shear[2];
    ray.shear[1] = ray.direction[ray.axis[1]] * ray.shear[2];
  }

  // The same for each.
  HWY_ATTR static HWY_INLINE void SetUp(RayColumns& rays) {
    const DNode d;
    const DNodeUint du;
    rays.same_axes = true;
    for (size_t first = 0; first < kPacketRays; first += kWidth) {
      const auto dx = hn::Load(d, rays.direction[0] + first), dy = hn::Load(d, rays.direction[1] + first),
                 dz = hn::Load(d, rays.direction[2] + first);
      const auto x = hn::Abs(dx), y = hn::Abs(dy), z = hn::Abs(dz);
      const auto z_is = hn::And(hn::Ge(z, x), hn::Ge(z, y)), y_is = hn::AndNot(z_is, hn::Gt(y, x));
      const auto if_last = [&](auto x_value, auto y_value, auto z_value) HWY_ATTR {
        const hn::DFromV<decltype(x_value)> dv;
        return hn::IfThenElse(hn::RebindMask(dv, z_is), z_value,
                              hn::IfThenElse(hn::RebindMask(dv, y_is), y_value, x_value));
      };
      const auto turned = hn::Lt(if_last(dx, dy, dz), hn::Zero(d));
      const auto next = if_last(dy, dz, dx), after = if_last(dz, dx, dy);
      const auto shear = if_last(hn::Load(d, rays.inverse[0] + first), hn::Load(d, rays.inverse[1] + first),
                                 hn::Load(d, rays.inverse[2] + first));
      hn::Store(hn::Mul(hn::IfThenElse(turned, after, next), shear), d, rays.shear[0] + first);
      hn::Store(hn::Mul(hn::IfThenElse(turned, next, after), shear), d, rays.shear[1] + first);
      hn::Store(shear, d, rays.shear[2] + first);
      const auto axis0 = hn::Zero(du), axis1 = hn::Set(du, 1), axis2 = hn::Set(du, 2);
      const auto next_axis = if_last(axis1, axis2, axis0), axis_after = if_last(axis2, axis0, axis1);
      const auto turned_u = hn::RebindMask(du, turned);
      const auto put = [&](int i, auto axis) HWY_ATTR {
        hn::Store(axis, du, rays.axis[i] + first);
        rays.same_axes &= hn::AllTrue(du, hn::Eq(axis, hn::Set(du, rays.axis[i][0])));
      };
      put(0, hn::IfThenElse(turned_u, axis_after, next_axis));
      put(1, hn::IfThenElse(turned_u, next_axis, axis_after));
      put(2, if_last(axis0, axis1, axis2));
    }
  }

  template <class D>
  struct First {
    hn::Vec<D> b, c;    // edge functions, which are the barycentric coordinates times the determinant
    hn::Vec<D> det, t;  // t times the determinant
    hn::Mask<D> mask;
  };

  template <typename Rays, typename Triangles, class D = typename Rays::D>
  HWY_ATTR static HWY_INLINE First<D> Start(const Rays& rays, const Triangles& triangles) {
    using V = hn::Vec<D>;
    using M = hn::Mask<D>;
    const D d;
    const uint32_t kx = rays.Axis(0), ky = rays.Axis(1), kz = rays.Axis(2);
    const V ox = rays.Origin(kx), oy = rays.Origin(ky), oz = rays.Origin(kz);
    const V shear_x = rays.Shear(0), shear_y = rays.Shear(1);
    const V az = hn::Sub(triangles.Corner(0, kz), oz);
    const V bz = hn::Sub(triangles.Corner(1, kz), oz);
    const V cz = hn::Sub(triangles.Corner(2, kz), oz);
    const V ax = hn::NegMulAdd(shear_x, az, hn::Sub(triangles.Corner(0, kx), ox));
    const V ay = hn::NegMulAdd(shear_y, az, hn::Sub(triangles.Corner(0, ky), oy));
    const V bx = hn::NegMulAdd(shear_x, bz, hn::Sub(triangles.Corner(1, kx), ox));
    const V by = hn::NegMulAdd(shear_y, bz, hn::Sub(triangles.Corner(1, ky), oy));
    const V cx = hn::NegMulAdd(shear_x, cz, hn::Sub(triangles.Corner(2, kx), ox));
    const V cy = hn::NegMulAdd(shear_y, cz, hn::Sub(triangles.Corner(2, ky), oy));
    First<D> result;
    const V a = hn::Sub(hn::Mul(cx, by), hn::Mul(cy, bx));
    result.b = hn::Sub(hn::Mul(ax, cy), hn::Mul(ay, cx));
    result.c = hn::Sub(hn::Mul(bx, ay), hn::Mul(by, ax));
    const V zero = hn::Zero(d);
    const M inside = hn::Or(hn::Ge(hn::Min(hn::Min(a, result.b), result.c), zero),
                            hn::Le(hn::Max(hn::Max(a, result.b), result.c), zero));
    result.det = hn::Add(hn::Add(a, result.b), result.c);
    result.t = hn::Mul(hn::MulAdd(a, az, hn::MulAdd(result.b, bz, hn::Mul(result.c, cz))), rays.Shear(2));
    const V sign = hn::And(result.det, hn::SignBit(d)), magnitude = hn::Abs(result.det);
    const M in_range = MayBeInRange(rays, hn::Xor(result.t, sign), magnitude);
    const M large = hn::Ge(magnitude, hn::Set(d, kLeastDeterminant));
    result.mask = hn::And(hn::And(inside, in_range), hn::And(large, triangles.Valid()));
    return result;
  }

  template <typename Rays, class D = typename Rays::D>
  HWY_ATTR static HWY_INLINE LeafHits<D> Finish(const Rays& rays, const First<D>& start, Culling culling) {
    const D d;
    const hn::Vec<D> inverse = hn::Div(hn::Set(d, 1.0f), start.det);
    LeafHits<D> hits;
    hits.t = hn::Mul(start.t, inverse);
    hits.u = hn::Mul(start.b, inverse), hits.v = hn::Mul(start.c, inverse);
    hits.back = hn::Lt(start.det, hn::Zero(d));
    hits.mask = hn::And(hn::And(start.mask, IsInRange(rays, hits.t)), NotCulled(d, culling, hits.back));
    return hits;
  }
};

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_LEAF_TEST_INL_H_
