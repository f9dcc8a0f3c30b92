// What exact queries make of the leaves that a ray comes to: see queries-inl.h.

#if defined(SERVER_TREE_EXACT_QUERIES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_EXACT_QUERIES_INL_H_
#undef SERVER_TREE_EXACT_QUERIES_INL_H_
#else
#define SERVER_TREE_EXACT_QUERIES_INL_H_
#endif

#include <cstdint>
#include <span>

#include "hwy/highway.h"
#include "server/geometry/ray.h"
#include "server/tree/collector.h"
#include "server/tree/decision-inl.h"
#include "server/tree/exact_leaf_test-inl.h"
#include "server/tree/leaf_lanes-inl.h"
#include "server/tree/packet_rays-inl.h"
#include "server/tree/queries-inl.h"
#include "server/tree/ray_setup-inl.h"
#include "server/tree/suspects.h"
#include "server/tree/wide_node.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

// Ends the rays of a packet whose answers are in their slots.
template <typename Query>
HWY_ATTR HWY_INLINE void EndSlots(Query& query, PacketRays& packet) {
  for (uint32_t i = 0; i < kPacketRays; ++i) {
    RaySlot* const slot = packet.SlotIfMade(i);
    if (slot != nullptr && slot->MayHit()) {
      query.End(*slot);
    } else {
      query.Miss(packet.first() + i);
    }
  }
}

// The closest hit at kExact. Triangles that the ray may hit wait in its slot; who is hit and where is decided at its
// end.
class ExactClosestQuery {
 public:
  using Test = ExactTest;
  using First = Test::First<DLeaf>;
  using FirstOfRays = Test::First<DNode>;
  static constexpr bool kOrdered = true;

  ExactClosestQuery(const WideScene& scene, std::span<const Ray> rays, const QueryOptions& options, std::span<Hit> hits)
      : scene_(scene),
        culling_(options.culling),
        hits_(hits),
        decider_(scene, rays, options, hits),
        queue_(scene, rays, options.culling, decider_, hits) {}

  // Decides what is still in the queue. REQUIRES: called once all rays have ended.
  HWY_ATTR void Finish() { queue_.Flush(); }

  HWY_ATTR HWY_INLINE void Take(RaySlot& ray, const LeafView& leaf, uint32_t first, const First& start) {
    KeepAll(ray, ray.current, first, Test::Finish(OneRay{ray}, LeafLanes{leaf, first}, start, culling_));
  }

  HWY_ATTR HWY_INLINE void TakeOne(PacketRays& packet, size_t i, ChildRef ref, const LeafView& leaf, uint32_t first,
                                   const First& start) {
    RaySlot& ray = packet.Slot(i);
    const OneOfRays rays{packet.columns(), i};
    KeepAll(ray, ref.bits(), first, Test::Finish(rays, LeafLanes{leaf, first}, start, culling_));
    packet.columns().limit[i] = ray.limit;
  }

  HWY_ATTR HWY_INLINE void TakeRays(PacketRays& packet, size_t first, ChildRef ref, const OneTriangle& triangle,
                                    const FirstOfRays& start) {
    const DNode d;
    RayColumns& rays = packet.columns();
    const auto suspects = Test::Finish(RayLanes{rays, first}, triangle, start, culling_);
    HWY_ALIGN float t[kWidth], certain_limit[kWidth];
    hn::Store(suspects.t, d, t), hn::Store(suspects.certain_limit, d, certain_limit);
    ForEach(d, suspects.mask, [&](uint32_t lane) {
      RaySlot& ray = packet.Slot(first + lane);
      if (certain_limit[lane] < ray.limit) SetLimit(ray, certain_limit[lane]);
      Keep(ray, {ref.bits(), triangle.lane}, t[lane]);
      rays.limit[first + lane] = ray.limit;
    });
  }

  HWY_ATTR void EndRays(PacketRays& packet) { EndSlots(*this, packet); }

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
  // Keeps the suspects of a leaf, from lane `first` on.
  HWY_ATTR HWY_INLINE void KeepAll(RaySlot& ray, uint32_t leaf, uint32_t first, const LeafSuspects<DLeaf>& suspects) {
    const DLeaf d;
    const float certain_limit = hn::GetLane(hn::MinOfLanes(d, suspects.certain_limit));
    if (certain_limit < ray.limit) SetLimit(ray, certain_limit);
    HWY_ALIGN float t[kLeafLanes];
    hn::Store(suspects.t, d, t);
    ForEach(d, suspects.mask, [&](uint32_t lane) { Keep(ray, {leaf, first + lane}, t[lane]); });
  }

  HWY_ATTR HWY_INLINE void Keep(RaySlot& ray, const Suspect& suspect, float t) {
    if (t > ray.limit) return;
    if (ray.suspect_count == RaySlot::kMaxSuspects) MakeRoom(ray);
    ray.suspect_t[ray.suspect_count] = t;
    ray.suspects[ray.suspect_count] = suspect;
    ++ray.suspect_count;
  }

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
  using First = Test::First<DLeaf>;
  using FirstOfRays = Test::First<DNode>;
  static constexpr bool kOrdered = false;

  ExactAnyQuery(Culling culling, AnyDecider& decider) : culling_(culling), decider_(decider) {}

  HWY_ATTR HWY_INLINE void Take(RaySlot& ray, const LeafView& leaf, uint32_t first, const First& start) {
    if (ray.primitive != kNoPrimitive) return;
    KeepAll(ray, ray.current, first, Test::Finish(OneRay{ray}, LeafLanes{leaf, first}, start, culling_));
  }

  HWY_ATTR HWY_INLINE void TakeOne(PacketRays& packet, size_t i, ChildRef ref, const LeafView& leaf, uint32_t first,
                                   const First& start) {
    RaySlot& ray = packet.Slot(i);
    if (ray.primitive != kNoPrimitive) return;
    const OneOfRays rays{packet.columns(), i};
    KeepAll(ray, ref.bits(), first, Test::Finish(rays, LeafLanes{leaf, first}, start, culling_));
    if (ray.primitive != kNoPrimitive) packet.columns().limit[i] = kNothingMatters;
  }

  HWY_ATTR HWY_INLINE void TakeRays(PacketRays& packet, size_t first, ChildRef ref, const OneTriangle& triangle,
                                    const FirstOfRays& start) {
    const DNode d;
    RayColumns& rays = packet.columns();
    const auto suspects = Test::Finish(RayLanes{rays, first}, triangle, start, culling_);
    HWY_ALIGN float certain_limit[kWidth];
    hn::Store(suspects.certain_limit, d, certain_limit);
    ForEach(d, suspects.mask, [&](uint32_t lane) {
      RaySlot& ray = packet.Slot(first + lane);
      if (ray.primitive != kNoPrimitive) return;
      if (certain_limit[lane] < ray.limit) {
        Found(ray);
      } else {
        Keep(ray, {ref.bits(), triangle.lane});
      }
      if (ray.primitive != kNoPrimitive) rays.limit[first + lane] = kNothingMatters;
    });
  }

  HWY_ATTR void EndRays(PacketRays& packet) { EndSlots(*this, packet); }

  void Miss(uint32_t ray) { decider_.Miss(ray); }

  HWY_ATTR void End(RaySlot& ray) { decider_.End(ray); }

 private:
  HWY_ATTR HWY_INLINE void KeepAll(RaySlot& ray, uint32_t leaf, uint32_t first, const LeafSuspects<DLeaf>& suspects) {
    if (hn::GetLane(hn::MinOfLanes(DLeaf(), suspects.certain_limit)) < ray.limit) return Found(ray);
    ForEach(DLeaf(), suspects.mask, [&](uint32_t lane) { Keep(ray, {leaf, first + lane}); });
  }

  HWY_ATTR HWY_INLINE void Keep(RaySlot& ray, const Suspect& suspect) {
    if (ray.suspect_count == RaySlot::kMaxSuspects && decider_.DecideEarly(ray)) Found(ray);
    if (ray.primitive != kNoPrimitive) return;
    ray.suspects[ray.suspect_count++] = suspect;
  }

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
  using First = Test::First<DLeaf>;
  using FirstOfRays = Test::First<DNode>;
  static constexpr bool kOrdered = true;

  explicit CollectQuery(Collector& collector) : collector_(collector) {}

  HWY_ATTR HWY_INLINE void Take(RaySlot& ray, const LeafView& leaf, uint32_t first, const First& start) {
    const auto suspects = Test::Finish(OneRay{ray}, LeafLanes{leaf, first}, start, Culling::kNone);
    ForEach(DLeaf(), suspects.mask, [&](uint32_t lane) { collector_.Visit(leaf.Primitive(first + lane)); });
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

#endif  // SERVER_TREE_EXACT_QUERIES_INL_H_
