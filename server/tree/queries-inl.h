// What a query makes of the leaves that a ray comes to. `kOrdered`: whether it matters which leaf comes first.
// Take: looks at the lanes in start.mask, of which there are some.

#if defined(SERVER_TREE_QUERIES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_QUERIES_INL_H_
#undef SERVER_TREE_QUERIES_INL_H_
#else
#define SERVER_TREE_QUERIES_INL_H_
#endif

#include <bit>
#include <cstdint>
#include <span>

#include "hwy/highway.h"
#include "server/tree/collector.h"
#include "server/tree/decision-inl.h"
#include "server/tree/leaf_test-inl.h"
#include "server/tree/ray_setup-inl.h"
#include "server/tree/suspects.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

// Calls lane(i, t) for each lane in hits.mask.
template <typename Lane>
HWY_ATTR HWY_INLINE void ForEachHit(const LeafHits& hits, Lane&& lane) {
  const DLeaf d;
  HWY_ALIGN float t[kLeafLanes];
  hn::Store(hits.t, d, t);
  uint8_t bits[8] = {};
  hn::StoreMaskBits(d, hits.mask, bits);
  for (uint32_t rest = bits[0]; rest != 0; rest &= rest - 1) {
    const uint32_t i = static_cast<uint32_t>(std::countr_zero(rest));
    lane(i, t[i]);
  }
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
  using First = typename Test::First;
  static constexpr bool kOrdered = true;

  ClosestQuery(Culling culling, std::span<Hit> hits) : culling_(culling), hits_(hits) {}

  HWY_ATTR static void SetUp(RaySlot& ray) { Test::SetUp(ray); }

  HWY_ATTR HWY_INLINE void Take(RaySlot& ray, const LeafView& leaf, uint32_t first, const First& start) {
    const DLeaf d;
    const LeafHits hits = Test::Finish(ray, start, culling_);
    HWY_ALIGN float u[kLeafLanes], v[kLeafLanes];
    hn::Store(hits.u, d, u);
    hn::Store(hits.v, d, v);
    uint8_t back[8] = {};
    hn::StoreMaskBits(d, hits.back, back);
    ForEachHit(hits, [&](uint32_t lane, float t) {
      const uint32_t primitive = leaf.Primitive(first + lane);
      if (primitive == ray.excluded || t > ray.limit) return;
      if (t == ray.limit && ray.primitive <= primitive) return;
      ray.t = t, ray.u = u[lane], ray.v = v[lane];
      ray.primitive = primitive;
      ray.back = back[0] >> lane & 1;
      SetLimit(ray, t);
    });
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
  const Culling culling_;
  const std::span<Hit> hits_;
};

// Whether there is a hit, at kFast and kWatertight.
template <typename LevelTest>
class AnyQuery {
 public:
  using Test = LevelTest;
  using First = typename Test::First;
  static constexpr bool kOrdered = false;

  AnyQuery(Culling culling, std::span<uint8_t> any) : culling_(culling), any_(any) {}

  HWY_ATTR static void SetUp(RaySlot& ray) { Test::SetUp(ray); }

  HWY_ATTR HWY_INLINE void Take(RaySlot& ray, const LeafView& leaf, uint32_t first, const First& start) {
    ForEachHit(Test::Finish(ray, start, culling_), [&](uint32_t lane, float) {
      const uint32_t primitive = leaf.Primitive(first + lane);
      if (primitive == ray.excluded) return;
      ray.primitive = primitive;
      ray.stack_size = 1;
    });
  }

  static float Limit(const RaySlot& ray) { return ray.primitive == kNoPrimitive ? ray.limit : kNothingMatters; }

  void Miss(uint32_t ray) { any_[ray] = 0; }

  HWY_ATTR void End(const RaySlot& ray) { any_[ray.ray] = 1; }

 private:
  const Culling culling_;
  const std::span<uint8_t> any_;
};

// The closest hit at kExact. Triangles that the ray may hit wait in its slot; who is hit and where is decided at its
// end.
class ExactClosestQuery {
 public:
  using Test = ExactTest;
  using First = Test::First;
  static constexpr bool kOrdered = true;

  ExactClosestQuery(const WideScene& scene, std::span<const Ray> rays, const QueryOptions& options, std::span<Hit> hits)
      : scene_(scene),
        culling_(options.culling),
        hits_(hits),
        decider_(scene, rays, options, hits),
        queue_(scene, rays, options.culling, decider_, hits) {}

  // Decides what is still in the queue. REQUIRES: called once all rays have ended.
  HWY_ATTR void Finish() { queue_.Flush(); }

  HWY_ATTR static void SetUp(RaySlot&) {}

  HWY_ATTR HWY_INLINE void Take(RaySlot& ray, const LeafView& leaf, uint32_t first, const First& start) {
    float certain_limit;
    const LeafHits hits = Test::Finish(ray, leaf, first, start, culling_, &certain_limit);
    if (certain_limit < ray.limit) SetLimit(ray, certain_limit);
    ForEachHit(hits, [&](uint32_t lane, float t) {
      if (t > ray.limit) return;
      if (ray.suspect_count == RaySlot::kMaxSuspects) MakeRoom(ray);
      ray.suspect_t[ray.suspect_count] = t;
      ray.suspects[ray.suspect_count] = {ray.current, first + lane};
      ++ray.suspect_count;
    });
  }

  static float Limit(const RaySlot& ray) { return ray.limit; }

  void Miss(uint32_t ray) { hits_[ray] = Hit(); }

  HWY_ATTR void End(RaySlot& ray) {
    if (ray.suspect_count > 1) DropNeedless(scene_, ray);
    if (ray.primitive != kNoPrimitive || !ray.exact) return decider_.Decide(ray);
    if (ray.suspect_count > 1) queue_.Narrow(ray);
    if (ray.suspect_count == 0) return Miss(ray.ray);
    if (ray.suspect_count > 1) return decider_.Decide(ray);
    queue_.Add(ray);
  }

 private:
  // Drops needless suspects; decides all there are where that gives no room.
  void MakeRoom(RaySlot& ray) {
    DropNeedless(scene_, ray);
    if (ray.suspect_count == RaySlot::kMaxSuspects) SetLimit(ray, decider_.DecideEarly(ray));
  }

  const WideScene& scene_;
  const Culling culling_;
  const std::span<Hit> hits_;
  ClosestDecider decider_;
  DecisionQueue queue_;
};

// Whether there is a hit, at kExact.
class ExactAnyQuery {
 public:
  using Test = ExactTest;
  using First = Test::First;
  static constexpr bool kOrdered = false;

  ExactAnyQuery(Culling culling, AnyDecider& decider) : culling_(culling), decider_(decider) {}

  HWY_ATTR static void SetUp(RaySlot&) {}

  HWY_ATTR HWY_INLINE void Take(RaySlot& ray, const LeafView& leaf, uint32_t first, const First& start) {
    if (ray.primitive != kNoPrimitive) return;
    float certain_limit;
    const LeafHits hits = Test::Finish(ray, leaf, first, start, culling_, &certain_limit);
    if (certain_limit < ray.limit) return Found(ray);
    ForEachHit(hits, [&](uint32_t lane, float) {
      if (ray.suspect_count == RaySlot::kMaxSuspects && decider_.DecideEarly(ray)) Found(ray);
      if (ray.primitive != kNoPrimitive) return;
      ray.suspects[ray.suspect_count++] = {ray.current, first + lane};
    });
  }

  static float Limit(const RaySlot& ray) { return ray.primitive == kNoPrimitive ? ray.limit : kNothingMatters; }

  void Miss(uint32_t ray) { decider_.Miss(ray); }

  HWY_ATTR void End(RaySlot& ray) { decider_.End(ray); }

 private:
  static void Found(RaySlot& ray) {
    // Any primitive will do: nobody asks which.
    ray.primitive = 0;
    ray.suspect_count = 0;
    ray.stack_size = 1;
  }

  const Culling culling_;
  AnyDecider& decider_;
};

// All triangles that a ray may hit, to a collector.
class CollectQuery {
 public:
  using Test = ExactTest;
  using First = Test::First;
  static constexpr bool kOrdered = true;

  explicit CollectQuery(Collector& collector) : collector_(collector) {}

  HWY_ATTR static void SetUp(RaySlot&) {}

  HWY_ATTR HWY_INLINE void Take(RaySlot& ray, const LeafView& leaf, uint32_t first, const First& start) {
    float certain_limit;
    const LeafHits hits = Test::Finish(ray, leaf, first, start, Culling::kNone, &certain_limit);
    ForEachHit(hits, [&](uint32_t lane, float) { collector_.Visit(leaf.Primitive(first + lane)); });
    if (collector_.IsDone()) {
      ray.stack_size = 1;
    } else {
      SetLimit(ray, LimitInFrame(ray, collector_.limit()));
    }
  }

  void Miss(uint32_t) {}
  HWY_ATTR void End(const RaySlot&) {}

 private:
  Collector& collector_;
};

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_QUERIES_INL_H_
