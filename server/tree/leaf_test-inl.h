// One ray against all triangles of a leaf at once, at each level of accuracy.

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
#include "server/tree/ray_slot.h"
#include "server/tree/wide_node.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

// Triangles that are tested at once: a whole leaf, or half of one where registers have only 4 lanes.
using DLeaf = hn::CappedTag<float, kMaxLeafTriangles>;
using VLeaf = hn::Vec<DLeaf>;
using MLeaf = hn::Mask<DLeaf>;
constexpr uint32_t kLeafLanes = hn::MaxLanes(DLeaf());
constexpr size_t kLeafParts = kMaxLeafTriangles / kLeafLanes;

// A leaf in memory.
struct LeafView {
  const float* columns;
  uint32_t count;

  HWY_ATTR VLeaf Corner(int corner, int axis, uint32_t first) const {
    return hn::LoadU(DLeaf(), columns + (3 * corner + axis) * count + first);
  }
  const uint32_t* ids() const { return reinterpret_cast<const uint32_t*>(columns + kIdColumn * count); }
  uint32_t Primitive(uint32_t lane) const { return ids()[lane] & kPrimitiveMask; }
  // Of each triangle: no edge is longer than this along any axis.
  HWY_ATTR VLeaf Sizes(uint32_t first) const {
    const hn::RebindToUnsigned<DLeaf> d;
    const auto size_class = hn::ShiftRight<kPrimitiveBits>(hn::LoadU(d, ids() + first));
    return hn::BitCast(DLeaf(), hn::ShiftLeft<23>(hn::Sub(hn::Set(d, 128), size_class)));
  }
};

// Some lanes of a leaf that a ray hits, with t, u, v in the tree's frame; or that it may hit, and t a lower bound.
struct LeafHits {
  MLeaf mask;
  VLeaf t, u, v;
  MLeaf back;
};

// Möller–Trumbore in float [Möller and Trumbore 1997]: t = T/det, u = U/det, v = V/det.
struct MollerTrumbore {
  VLeaf det, u, v, t;
  VLeaf sx, sy, sz;  // from the first corner to the ray's origin

  HWY_ATTR MollerTrumbore(const RaySlot& ray, const LeafView& leaf, uint32_t first) {
    const DLeaf d;
    const VLeaf x0 = leaf.Corner(0, 0, first), y0 = leaf.Corner(0, 1, first), z0 = leaf.Corner(0, 2, first);
    const VLeaf e1x = hn::Sub(leaf.Corner(1, 0, first), x0), e2x = hn::Sub(leaf.Corner(2, 0, first), x0);
    const VLeaf e1y = hn::Sub(leaf.Corner(1, 1, first), y0), e2y = hn::Sub(leaf.Corner(2, 1, first), y0);
    const VLeaf e1z = hn::Sub(leaf.Corner(1, 2, first), z0), e2z = hn::Sub(leaf.Corner(2, 2, first), z0);
    const VLeaf dx = hn::Set(d, ray.direction[0]), dy = hn::Set(d, ray.direction[1]), dz = hn::Set(d, ray.direction[2]);
    sx = hn::Sub(hn::Set(d, ray.origin[0]), x0);
    sy = hn::Sub(hn::Set(d, ray.origin[1]), y0);
    sz = hn::Sub(hn::Set(d, ray.origin[2]), z0);
    const VLeaf px = Difference(dy, e2z, dz, e2y), py = Difference(dz, e2x, dx, e2z), pz = Difference(dx, e2y, dy, e2x);
    const VLeaf qx = Difference(sy, e1z, sz, e1y), qy = Difference(sz, e1x, sx, e1z), qz = Difference(sx, e1y, sy, e1x);
    det = Dot(e1x, e1y, e1z, px, py, pz);
    u = Dot(sx, sy, sz, px, py, pz);
    v = Dot(dx, dy, dz, qx, qy, qz);
    t = Dot(e2x, e2y, e2z, qx, qy, qz);
  }

 private:
  HWY_ATTR static VLeaf Difference(VLeaf a, VLeaf b, VLeaf c, VLeaf d) { return hn::MulSub(a, b, hn::Mul(c, d)); }
  HWY_ATTR static VLeaf Dot(VLeaf ax, VLeaf ay, VLeaf az, VLeaf bx, VLeaf by, VLeaf bz) {
    return hn::MulAdd(ax, bx, hn::MulAdd(ay, by, hn::Mul(az, bz)));
  }
};

// Lanes of which the sign bit is set.
HWY_ATTR HWY_INLINE MLeaf IsNegative(VLeaf x) {
  const hn::RebindToSigned<DLeaf> di;
  return hn::RebindMask(DLeaf(), hn::Lt(hn::BitCast(di, x), hn::Zero(di)));
}

HWY_ATTR HWY_INLINE MLeaf NotCulled(Culling culling, MLeaf back) {
  const MLeaf all = hn::FirstN(DLeaf(), kLeafLanes);
  return culling == Culling::kNone ? all : culling == Culling::kBack ? hn::Not(back) : back;
}

// Each level is a test in two steps: the first one finds the lanes that may be hit, mostly none; the second one, which
// takes what the first one found out, is for the rare leaves that have some.

// Determinants below this count as 0 in float: their inverses may be infinite, and infinity times 0 no number.
constexpr float kLeastDeterminant = 0x1p-126f;

// AccuracyLevel::kFast.
struct FastTest {
  static constexpr bool kExact = false;

  struct First {
    VLeaf det, u, v, t;  // turned so that the determinant counts as positive
    VLeaf sign;
    MLeaf mask;
  };

  HWY_ATTR static void SetUp(RaySlot&) {}

  HWY_ATTR static HWY_INLINE First Start(const RaySlot& ray, const LeafView& leaf, uint32_t first) {
    const DLeaf d;
    const MollerTrumbore test(ray, leaf, first);
    First result;
    result.sign = hn::And(test.det, hn::SignBit(d));
    result.det = hn::Xor(test.det, result.sign);
    result.u = hn::Xor(test.u, result.sign), result.v = hn::Xor(test.v, result.sign);
    result.t = hn::Xor(test.t, result.sign);
    const VLeaf zero = hn::Zero(d);
    const MLeaf inside =
        hn::And(hn::Ge(hn::Min(result.u, result.v), zero), hn::Le(hn::Add(result.u, result.v), result.det));
    const MLeaf in_range = hn::And(hn::Ge(result.t, hn::Mul(hn::Set(d, ray.t_min), result.det)),
                                   hn::Le(result.t, hn::Mul(hn::Set(d, ray.limit), result.det)));
    const MLeaf large = hn::Ge(result.det, hn::Set(d, kLeastDeterminant));
    result.mask = hn::And(hn::And(inside, in_range), hn::And(large, hn::FirstN(d, leaf.count - first)));
    return result;
  }

  HWY_ATTR static HWY_INLINE LeafHits Finish(const RaySlot&, const First& start, Culling culling) {
    const DLeaf d;
    const VLeaf inverse = hn::Div(hn::Set(d, 1.0f), start.det);
    LeafHits hits;
    hits.t = hn::Mul(start.t, inverse), hits.u = hn::Mul(start.u, inverse), hits.v = hn::Mul(start.v, inverse);
    hits.back = IsNegative(start.sign);
    hits.mask = hn::And(start.mask, NotCulled(culling, hits.back));
    return hits;
  }
};

// AccuracyLevel::kWatertight: [Woop 2013]. The triangle is sheared so that the ray runs along the last axis through 0;
// its edges' functions there are computed from the same two corners in the same way for both triangles at an edge. A
// sign is never wrong: products are rounded before they are compared, not fused, and 0 counts as inside.
struct WatertightTest {
  static constexpr bool kExact = false;

  // Without branches: which axis comes last, and whether it is turned, can not be foretold.
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

  struct First {
    VLeaf b, c;    // edge functions, which are the barycentric coordinates times the determinant
    VLeaf det, t;  // t times the determinant
    MLeaf mask;
  };

  HWY_ATTR static HWY_INLINE First Start(const RaySlot& ray, const LeafView& leaf, uint32_t first) {
    const DLeaf d;
    const uint32_t kx = ray.axis[0], ky = ray.axis[1], kz = ray.axis[2];
    const VLeaf ox = hn::Set(d, ray.origin[kx]), oy = hn::Set(d, ray.origin[ky]), oz = hn::Set(d, ray.origin[kz]);
    const VLeaf shear_x = hn::Set(d, ray.shear[0]), shear_y = hn::Set(d, ray.shear[1]);
    const VLeaf az = hn::Sub(leaf.Corner(0, kz, first), oz);
    const VLeaf bz = hn::Sub(leaf.Corner(1, kz, first), oz);
    const VLeaf cz = hn::Sub(leaf.Corner(2, kz, first), oz);
    const VLeaf ax = hn::NegMulAdd(shear_x, az, hn::Sub(leaf.Corner(0, kx, first), ox));
    const VLeaf ay = hn::NegMulAdd(shear_y, az, hn::Sub(leaf.Corner(0, ky, first), oy));
    const VLeaf bx = hn::NegMulAdd(shear_x, bz, hn::Sub(leaf.Corner(1, kx, first), ox));
    const VLeaf by = hn::NegMulAdd(shear_y, bz, hn::Sub(leaf.Corner(1, ky, first), oy));
    const VLeaf cx = hn::NegMulAdd(shear_x, cz, hn::Sub(leaf.Corner(2, kx, first), ox));
    const VLeaf cy = hn::NegMulAdd(shear_y, cz, hn::Sub(leaf.Corner(2, ky, first), oy));
    First result;
    const VLeaf a = hn::Sub(hn::Mul(cx, by), hn::Mul(cy, bx));
    result.b = hn::Sub(hn::Mul(ax, cy), hn::Mul(ay, cx));
    result.c = hn::Sub(hn::Mul(bx, ay), hn::Mul(by, ax));
    const VLeaf zero = hn::Zero(d);
    const MLeaf inside = hn::Or(hn::Ge(hn::Min(hn::Min(a, result.b), result.c), zero),
                                hn::Le(hn::Max(hn::Max(a, result.b), result.c), zero));
    result.det = hn::Add(hn::Add(a, result.b), result.c);
    result.t = hn::Mul(hn::MulAdd(a, az, hn::MulAdd(result.b, bz, hn::Mul(result.c, cz))), hn::Set(d, ray.shear[2]));
    const VLeaf sign = hn::And(result.det, hn::SignBit(d));
    const VLeaf after = hn::Xor(hn::NegMulAdd(hn::Set(d, ray.t_min), result.det, result.t), sign);
    const VLeaf before = hn::Xor(hn::MulSub(hn::Set(d, ray.limit), result.det, result.t), sign);
    const MLeaf in_range = hn::Ge(hn::Min(after, before), zero);
    const MLeaf large = hn::Ge(hn::Abs(result.det), hn::Set(d, kLeastDeterminant));
    result.mask = hn::And(hn::And(inside, in_range), hn::And(large, hn::FirstN(d, leaf.count - first)));
    return result;
  }

  HWY_ATTR static HWY_INLINE LeafHits Finish(const RaySlot&, const First& start, Culling culling) {
    const DLeaf d;
    const VLeaf inverse = hn::Div(hn::Set(d, 1.0f), start.det);
    LeafHits hits;
    hits.t = hn::Mul(start.t, inverse);
    hits.u = hn::Mul(start.b, inverse), hits.v = hn::Mul(start.c, inverse);
    hits.back = hn::Lt(start.det, hn::Zero(d));
    hits.mask = hn::And(start.mask, NotCulled(culling, hits.back));
    return hits;
  }
};

// AccuracyLevel::kExact, first stage: keeps all triangles that the ray may hit. Each value is known within its slack;
// README.md derives them.
struct ExactTest {
  static constexpr bool kExact = true;

  HWY_ATTR static void SetUp(RaySlot&) {}

  // What the first step hands on is kept for every leaf, so that it is little; the second one works the rest out again.
  struct First {
    VLeaf det, u, v, t;  // turned so that the determinant counts as positive
    VLeaf sign;
    VLeaf far;  // the first corner's distance from the ray's origin along the farthest axis
    MLeaf mask;
  };

  HWY_ATTR static HWY_INLINE First Start(const RaySlot& ray, const LeafView& leaf, uint32_t first) {
    const DLeaf d;
    const MollerTrumbore test(ray, leaf, first);
    First result;
    result.sign = hn::And(test.det, hn::SignBit(d));
    result.det = hn::Xor(test.det, result.sign);
    result.u = hn::Xor(test.u, result.sign), result.v = hn::Xor(test.v, result.sign);
    result.t = hn::Xor(test.t, result.sign);
    result.far = hn::Max(hn::Max(hn::Abs(test.sx), hn::Abs(test.sy)), hn::Abs(test.sz));

    // Certainly beside the triangle, whether or not the determinant has a certain sign.
    const Slack slack(ray, leaf, first, result.far);
    const VLeaf w = hn::Sub(hn::Sub(result.det, result.u), result.v);
    const VLeaf most_outside = hn::Neg(hn::Min(hn::Min(result.u, result.v), w));
    const MLeaf sure = hn::Gt(result.det, slack.det);
    const MLeaf beside = hn::Gt(most_outside, slack.edge);
    const MLeaf far_beside = hn::Gt(hn::Mul(most_outside, hn::Set(d, 0.25f)), slack.edge);
    const Ends ends(ray, result, slack);
    const MLeaf out = hn::Or(far_beside, hn::And(sure, hn::Or(beside, ends.outside())));
    result.mask = hn::AndNot(out, hn::FirstN(d, leaf.count - first));
    return result;
  }

  // Of the lanes in `mask` the ray may hit the triangle; t is a lower bound. `certain_limit`: no hit beyond it matters
  // once these are looked at, for one of them is hit at less.
  HWY_ATTR static HWY_INLINE LeafHits Finish(const RaySlot& ray, const LeafView& leaf, uint32_t first,
                                             const First& start, Culling culling, float* certain_limit) {
    const DLeaf d;
    const VLeaf det = start.det, t = start.t;
    const Slack slack(ray, leaf, first, start.far);
    const VLeaf t_slack = slack.t;
    const MLeaf sure = hn::Gt(det, slack.det);
    // 1. Culled for certain, excluded, or certainly out of the interval.
    LeafHits hits;
    hits.back = IsNegative(start.sign);
    const MLeaf culled = hn::Not(NotCulled(culling, hits.back));
    const hn::RebindToUnsigned<DLeaf> du;
    const auto ids = hn::And(hn::LoadU(du, leaf.ids() + first), hn::Set(du, kPrimitiveMask));
    const MLeaf excluded = hn::RebindMask(d, hn::Eq(ids, hn::Set(du, ray.excluded)));
    hits.mask = hn::AndNot(hn::Or(excluded, hn::And(sure, culled)), start.mask);

    // 2. Bounds of t: (T -+ slack) / (det +- slack), and the roundings of that.
    const VLeaf t_low = hn::Sub(t, t_slack), t_high = hn::Add(t, t_slack);
    const VLeaf det_low = hn::Sub(det, slack.det), det_high = hn::Add(det, slack.det);
    const VLeaf zero = hn::Zero(d), down = hn::Set(d, 1 - 0x1p-21f), up = hn::Set(d, 1 + 0x1p-21f);
    const MLeaf low_negative = hn::Lt(t_low, zero), high_negative = hn::Lt(t_high, zero);
    const VLeaf lower = hn::Mul(hn::Div(t_low, hn::IfThenElse(low_negative, det_low, det_high)),
                                hn::IfThenElse(low_negative, up, down));
    const VLeaf upper = hn::Mul(hn::Div(t_high, hn::IfThenElse(high_negative, det_high, det_low)),
                                hn::IfThenElse(high_negative, down, up));
    hits.t = hn::IfThenElse(sure, lower, hn::Set(d, -hwy::HighestValue<float>()));

    // 3. Hits for certain.
    const VLeaf w = hn::Sub(hn::Sub(det, start.u), start.v);
    const MLeaf inside = hn::And(sure, hn::Gt(hn::Min(hn::Min(start.u, start.v), w), slack.edge));
    const Ends ends(ray, start, slack);
    const MLeaf certain = hn::And(hits.mask, hn::And(inside, ends.within()));
    *certain_limit = hn::GetLane(hn::MinOfLanes(d, hn::IfThenElse(certain, upper, hn::Set(d, ray.limit))));
    return hits;
  }

 private:
  // Error bounds: (far + L / 2) L of U, V, W, with a factor; L² of the determinant, with another; and far L² of T.
  struct Slack {
    VLeaf det, edge, t;
    VLeaf size2, t_factor;

    HWY_ATTR HWY_INLINE Slack(const RaySlot& ray, const LeafView& leaf, uint32_t first, VLeaf far) {
      const DLeaf d;
      const VLeaf size = leaf.Sizes(first);
      size2 = hn::Mul(size, size);
      det = hn::Mul(hn::Set(d, ray.det_slack), size2);
      edge = hn::Mul(hn::Mul(hn::Set(d, ray.edge_slack), size), hn::MulAdd(hn::Set(d, 0.5f), size, far));
      t_factor = hn::Mul(hn::Set(d, 60 * 0x1p-24f), far);
      t = hn::Mul(t_factor, size2);
    }
  };

  // How far t is outside of the ends of the interval, times the determinant, where its sign is certain; and how far off
  // that may be.
  struct Ends {
    VLeaf before, beyond, before_slack, beyond_slack;

    HWY_ATTR HWY_INLINE Ends(const RaySlot& ray, const First& test, const Slack& slack) {
      const DLeaf d;
      const VLeaf t_min = hn::Set(d, ray.t_min), limit = hn::Set(d, ray.limit);
      before = hn::MulSub(t_min, test.det, test.t);
      beyond = hn::NegMulAdd(limit, test.det, test.t);
      before_slack = EndSlack(ray, t_min, slack), beyond_slack = EndSlack(ray, limit, slack);
    }

    HWY_ATTR HWY_INLINE MLeaf outside() const {
      return hn::Or(hn::Gt(before, before_slack), hn::Gt(beyond, beyond_slack));
    }
    HWY_ATTR HWY_INLINE MLeaf within() const {
      return hn::And(hn::Lt(before, hn::Neg(before_slack)), hn::Lt(beyond, hn::Neg(beyond_slack)));
    }

    // The error bound of T - end * det.
    HWY_ATTR static HWY_INLINE VLeaf EndSlack(const RaySlot& ray, VLeaf end, const Slack& slack) {
      return hn::Mul(hn::MulAdd(hn::Set(DLeaf(), ray.end_slack), hn::Abs(end), slack.t_factor), slack.size2);
    }
  };
};

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_LEAF_TEST_INL_H_
