// What a query makes of the leaves that a ray comes to. `kOrdered`: whether it matters which leaf comes first.
// Take: looks at the triangles in start.mask, of which there are some, of the leaf that the ray has come to.
// TakeOne: the same for ray i of a packet, which has come to the leaf `ref`.
// TakeRays: looks at one triangle of that leaf, for those rays of a packet, from `first` on, in start.mask.
// These two lower the rays' limits in the packet's columns, to kNothingMatters where the answer is known.
// EndRays: writes the answers of a packet.

#if defined(SERVER_TREE_QUERIES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_QUERIES_INL_H_
#undef SERVER_TREE_QUERIES_INL_H_
#else
#define SERVER_TREE_QUERIES_INL_H_
#endif

#include <algorithm>
#include <bit>
#include <cstdint>
#include <span>

#include "hwy/highway.h"
#include "server/tree/leaf_lanes-inl.h"
#include "server/tree/leaf_test-inl.h"
#include "server/tree/packet_rays-inl.h"
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

// Ray i of a packet, by the names of a slot's answer.
struct RayOfPacket {
  RayOfPacket(RayColumns& rays, size_t i)
      : excluded(rays.excluded[i]),
        limit(rays.limit[i]),
        t(rays.t[i]),
        u(rays.u[i]),
        v(rays.v[i]),
        primitive(rays.primitive[i]),
        back(rays.back[i]) {}

  const uint32_t excluded;
  float &limit, &t, &u, &v;
  uint32_t &primitive, &back;
};
inline void SetLimit(RayOfPacket& ray, float limit) { ray.limit = limit; }

// The closest hit at kFast and kWatertight.
template <typename LevelTest>
class ClosestQuery {
 public:
  using Test = LevelTest;
  using First = typename Test::template First<DLeaf>;
  using FirstOfRays = typename Test::template First<DNode>;
  static constexpr bool kOrdered = true;

  ClosestQuery(Culling culling, std::span<Hit> hits) : culling_(culling), hits_(hits) {}

  HWY_ATTR HWY_INLINE void Take(RaySlot& ray, const LeafView& leaf, uint32_t first, const First& start) {
    const DLeaf d;
    ForEachHit(d, Test::Finish(OneRay{ray}, start, culling_),
               [&](uint32_t lane, const Hit& hit) { Keep(ray, leaf.Primitive(first + lane), hit); });
  }

  HWY_ATTR HWY_INLINE void TakeOne(PacketRays& packet, size_t i, ChildRef, const LeafView& leaf, uint32_t first,
                                   const First& start) {
    RayOfPacket ray(packet.columns(), i);
    ForEachHit(DLeaf(), Test::Finish(OneOfRays{packet.columns(), i}, start, culling_),
               [&](uint32_t lane, const Hit& hit) { Keep(ray, leaf.Primitive(first + lane), hit); });
  }

  // Keep, for all rays at once.
  HWY_ATTR HWY_INLINE void TakeRays(PacketRays& packet, size_t first, ChildRef, const OneTriangle& triangle,
                                    const FirstOfRays& start) {
    const DNode d;
    const DNodeUint du;
    RayColumns& rays = packet.columns();
    const auto hits = Test::Finish(RayLanes{rays, first}, start, culling_);
    const auto primitive = hn::Set(du, triangle.Primitive()), old_primitive = hn::Load(du, rays.primitive + first);
    const auto excluded = hn::Eq(primitive, hn::Load(du, rays.excluded + first));
    const auto old_t = hn::Load(d, rays.t + first), limit = hn::Load(d, rays.limit + first);
    const auto tie_won = hn::And(hn::Eq(hits.t, old_t), hn::RebindMask(d, hn::Lt(primitive, old_primitive)));
    const auto closer = hn::AndNot(hn::RebindMask(d, excluded), hn::Or(hn::Lt(hits.t, old_t), tie_won));
    const auto kept = hn::And(hits.mask, closer);
    const auto kept_u = hn::RebindMask(du, kept);
    hn::BlendedStore(hits.t, kept, d, rays.t + first);
    hn::BlendedStore(hits.u, kept, d, rays.u + first);
    hn::BlendedStore(hits.v, kept, d, rays.v + first);
    hn::BlendedStore(primitive, kept_u, du, rays.primitive + first);
    const auto back = hn::IfThenElseZero(hn::RebindMask(du, hits.back), hn::Set(du, 1));
    hn::BlendedStore(back, kept_u, du, rays.back + first);
    hn::BlendedStore(hn::Min(limit, LimitOf(hits.t)), kept, d, rays.limit + first);
  }

  HWY_ATTR void EndRays(PacketRays& packet) {
    const DNode d;
    const RayColumns& rays = packet.columns();
    for (size_t part = 0; part < kPacketRays; part += kWidth) {
      HWY_ALIGN float t[kWidth];
      hn::Store(RaySetup<false>::Times(hn::Load(d, rays.t + part), packet.t_unscale()), d, t);
      for (size_t i = 0; i < kWidth; ++i) {
        hits_[packet.first() + part + i] = {.t = t[i],
                                            .u = rays.u[part + i],
                                            .v = rays.v[part + i],
                                            .primitive = rays.primitive[part + i],
                                            .back = rays.back[part + i] != 0};
      }
    }
  }

  void Miss(uint32_t ray) { hits_[ray] = Hit(); }

  HWY_ATTR void End(const RaySlot& ray) {
    hits_[ray.ray] = {.t = static_cast<float>(ray.t * ray.t_unscale),
                      .u = ray.u,
                      .v = ray.v,
                      .primitive = ray.primitive,
                      .back = ray.back != 0};
  }

 private:
  // So much farther that leaf tests, whose roundings are less, let through all that is at the same t: among these the
  // lowest id counts, whichever comes first.
  template <class V>
  HWY_ATTR static HWY_INLINE V LimitOf(V t) {
    return hn::Add(t, hn::Mul(hn::Abs(t), hn::Set(hn::DFromV<V>(), 0x1p-21f)));
  }

  template <typename RayAnswer>
  HWY_ATTR static HWY_INLINE void Keep(RayAnswer& ray, uint32_t primitive, const Hit& hit) {
    if (primitive == ray.excluded) return;
    const bool is_first = ray.primitive == kNoPrimitive;
    if (!is_first && (hit.t > ray.t || (hit.t == ray.t && ray.primitive <= primitive))) return;
    ray.t = hit.t, ray.u = hit.u, ray.v = hit.v;
    ray.primitive = primitive;
    ray.back = hit.back;
    const hn::CappedTag<float, 1> one;
    SetLimit(ray, std::min(ray.limit, hn::GetLane(LimitOf(hn::Set(one, hit.t)))));
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

  HWY_ATTR HWY_INLINE void Take(RaySlot& ray, const LeafView& leaf, uint32_t first, const First& start) {
    const DLeaf d;
    ForEach(d, Test::Finish(OneRay{ray}, start, culling_).mask,
            [&](uint32_t lane) { Keep(ray, leaf.Primitive(first + lane)); });
  }

  HWY_ATTR HWY_INLINE void TakeOne(PacketRays& packet, size_t i, ChildRef, const LeafView& leaf, uint32_t first,
                                   const First& start) {
    RayColumns& rays = packet.columns();
    ForEach(DLeaf(), Test::Finish(OneOfRays{rays, i}, start, culling_).mask, [&](uint32_t lane) {
      const uint32_t primitive = leaf.Primitive(first + lane);
      if (primitive == rays.excluded[i]) return;
      rays.primitive[i] = primitive;
      rays.limit[i] = kNothingMatters;
    });
  }

  HWY_ATTR HWY_INLINE void TakeRays(PacketRays& packet, size_t first, ChildRef, const OneTriangle& triangle,
                                    const FirstOfRays& start) {
    const DNode d;
    const DNodeUint du;
    RayColumns& rays = packet.columns();
    const auto hit = Test::Finish(RayLanes{rays, first}, start, culling_).mask;
    const auto primitive = hn::Set(du, triangle.Primitive());
    const auto kept = hn::AndNot(hn::Eq(primitive, hn::Load(du, rays.excluded + first)), hn::RebindMask(du, hit));
    hn::BlendedStore(primitive, kept, du, rays.primitive + first);
    hn::BlendedStore(hn::Set(d, kNothingMatters), hn::RebindMask(d, kept), d, rays.limit + first);
  }

  HWY_ATTR void EndRays(PacketRays& packet) {
    for (uint32_t i = 0; i < kPacketRays; ++i) {
      any_[packet.first() + i] = packet.columns().primitive[i] != kNoPrimitive;
    }
  }

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
