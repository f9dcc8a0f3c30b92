// What a query makes of the leaves that a ray comes to. `kOrdered`: whether it matters which leaf comes first.
// Take: looks at the triangles in start.mask, of which there are some, of the leaf that the ray has come to.
// TakeRays: looks at one triangle of the leaf that all of `slots` have come to, for those in start.mask.

#if defined(SERVER_TREE_QUERIES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_QUERIES_INL_H_
#undef SERVER_TREE_QUERIES_INL_H_
#else
#define SERVER_TREE_QUERIES_INL_H_
#endif

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <span>

#include "hwy/highway.h"
#include "server/tree/leaf_lanes-inl.h"
#include "server/tree/leaf_test-inl.h"
#include "server/tree/ray_setup-inl.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

// Calls lane(i) for each lane in the mask.
template <class D, typename Lane>
HWY_ATTR HWY_INLINE void ForEach(D d, hn::Mask<D> mask, Lane&& lane) {
  uint8_t bits[8] = {};
  hn::StoreMaskBits(d, mask, bits);
  for (uint32_t rest = bits[0] | uint32_t{bits[1]} << 8; rest != 0; rest &= rest - 1) {
    lane(static_cast<uint32_t>(std::countr_zero(rest)));
  }
}

// Calls lane(i, hit) for each lane that is a hit, with what an answer needs but for the primitive.
template <class D, typename Lane>
HWY_ATTR HWY_INLINE void ForEachHit(D d, const LeafHits<D>& hits, Lane&& lane) {
  HWY_ALIGN float t[hn::MaxLanes(d)], u[hn::MaxLanes(d)], v[hn::MaxLanes(d)];
  hn::Store(hits.t, d, t), hn::Store(hits.u, d, u), hn::Store(hits.v, d, v);
  uint8_t back[8] = {};
  hn::StoreMaskBits(d, hits.back, back);
  ForEach(d, hits.mask, [&](uint32_t i) {
    lane(i, Hit{.t = t[i], .u = u[i], .v = v[i], .back = (back[i / 8] >> (i % 8) & 1) != 0});
  });
}

// Writes the answer of a ray. Each query has Miss, and End for rays that may hit something.
template <typename Query>
HWY_ATTR HWY_INLINE void EndRay(Query& query, RaySlot& ray) {
  if (ray.MayHit()) {
    query.End(ray);
  } else {
    query.Miss(ray.ray);
  }
}

// The closest hit at kFast and kWatertight.
template <typename LevelTest>
class ClosestQuery {
 public:
  using Test = LevelTest;
  using First = typename Test::template First<DLeaf>;
  using FirstOfRays = typename Test::template First<DNode>;
  static constexpr bool kOrdered = true;

  ClosestQuery(Culling culling, std::span<Hit> hits) : culling_(culling), hits_(hits) {}

  HWY_ATTR static void SetUp(RaySlot& ray) { Test::SetUp(ray); }

  HWY_ATTR HWY_INLINE void Take(RaySlot& ray, const LeafView& leaf, uint32_t first, const First& start) {
    const DLeaf d;
    ForEachHit(d, Test::Finish(OneRay{ray}, start, culling_),
               [&](uint32_t lane, const Hit& hit) { Keep(ray, leaf.Primitive(first + lane), hit); });
  }

  template <size_t kRays>
  HWY_ATTR HWY_INLINE void TakeRays(RaySlot* slots, const RayLanes<kRays>& rays, const OneTriangle& triangle,
                                    const FirstOfRays& start) {
    const DNode d;
    const uint32_t primitive = triangle.leaf.Primitive(triangle.lane);
    ForEachHit(d, Test::Finish(rays, start, culling_),
               [&](uint32_t lane, const Hit& hit) { Keep(slots[lane], primitive, hit); });
  }

  static float Limit(const RaySlot& ray) { return ray.limit; }

  void Miss(uint32_t ray) { hits_[ray] = Hit(); }

  HWY_ATTR void End(const RaySlot& ray) {
    hits_[ray.ray] = {.t = static_cast<float>(ray.t * ray.t_unscale),
                      .u = ray.u,
                      .v = ray.v,
                      .primitive = ray.primitive,
                      .back = ray.back != 0};
  }

 private:
  HWY_ATTR static HWY_INLINE void Keep(RaySlot& ray, uint32_t primitive, const Hit& hit) {
    if (primitive == ray.excluded) return;
    const bool is_first = ray.primitive == kNoPrimitive;
    if (!is_first && (hit.t > ray.t || (hit.t == ray.t && ray.primitive <= primitive))) return;
    ray.t = hit.t, ray.u = hit.u, ray.v = hit.v;
    ray.primitive = primitive;
    ray.back = hit.back;
    // So much farther that leaf tests, whose roundings are less, let through all that is at the same t: among these the
    // lowest id counts, whichever comes first.
    SetLimit(ray, std::min(ray.limit, hit.t + std::abs(hit.t) * 0x1p-21f));
  }

  const Culling culling_;
  const std::span<Hit> hits_;
};

// Whether there is a hit, at kFast and kWatertight.
template <typename LevelTest>
class AnyQuery {
 public:
  using Test = LevelTest;
  using First = typename Test::template First<DLeaf>;
  using FirstOfRays = typename Test::template First<DNode>;
  static constexpr bool kOrdered = false;

  AnyQuery(Culling culling, std::span<uint8_t> any) : culling_(culling), any_(any) {}

  HWY_ATTR static void SetUp(RaySlot& ray) { Test::SetUp(ray); }

  HWY_ATTR HWY_INLINE void Take(RaySlot& ray, const LeafView& leaf, uint32_t first, const First& start) {
    const DLeaf d;
    ForEach(d, Test::Finish(OneRay{ray}, start, culling_).mask,
            [&](uint32_t lane) { Keep(ray, leaf.Primitive(first + lane)); });
  }

  template <size_t kRays>
  HWY_ATTR HWY_INLINE void TakeRays(RaySlot* slots, const RayLanes<kRays>& rays, const OneTriangle& triangle,
                                    const FirstOfRays& start) {
    const DNode d;
    const uint32_t primitive = triangle.leaf.Primitive(triangle.lane);
    ForEach(d, Test::Finish(rays, start, culling_).mask, [&](uint32_t lane) { Keep(slots[lane], primitive); });
  }

  static float Limit(const RaySlot& ray) { return ray.primitive == kNoPrimitive ? ray.limit : kNothingMatters; }

  void Miss(uint32_t ray) { any_[ray] = 0; }

  HWY_ATTR void End(const RaySlot& ray) { any_[ray.ray] = 1; }

 private:
  static void Keep(RaySlot& ray, uint32_t primitive) {
    if (primitive == ray.excluded) return;
    ray.primitive = primitive;
    ray.stack_size = 1;
  }

  const Culling culling_;
  const std::span<uint8_t> any_;
};

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_QUERIES_INL_H_
