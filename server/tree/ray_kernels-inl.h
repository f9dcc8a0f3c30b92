// The kernels of RayKernels, for one target.

#if defined(SERVER_TREE_RAY_KERNELS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_RAY_KERNELS_INL_H_
#undef SERVER_TREE_RAY_KERNELS_INL_H_
#else
#define SERVER_TREE_RAY_KERNELS_INL_H_
#endif

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "hwy/highway.h"
#include "server/tree/batch_traversal-inl.h"
#include "server/tree/exact_queries-inl.h"
#include "server/tree/packet_traversal-inl.h"
#include "server/tree/queries-inl.h"
#include "server/tree/ray_kernels.h"
#include "server/tree/stream_traversal-inl.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

// Rays begin to end - 1, each on its own.
template <typename Query>
HWY_ATTR void TraceApart(const WideScene& scene, std::span<const Ray> rays, size_t begin, size_t end, size_t in_flight,
                         Query& query, std::vector<uint32_t>* odd) {
  if (begin == end) return;
  if (scene.arrays.block.size() > kPrefetchBytes) {
    BatchTraversal<Query, true>(scene, rays, begin, end, query, in_flight, odd).Run();
  } else {
    BatchTraversal<Query, false>(scene, rays, begin, end, query, in_flight, odd).Run();
  }
}

// Where rays turn out to be better off apart, so many are traced so before it is tried again to lead some together.
constexpr size_t kPacketPause = 256, kStreamPause = 512;
// Streams whose entries are shared by fewer rays than this are slower than rays apart.
constexpr double kLeastShare = 3;

// Rays begin to end - 1, in streams where neighbours share their ways: whether they do, the last stream has told.
// `always`: whether or not they do.
template <typename Query>
HWY_ATTR void TraceStreams(const WideScene& scene, std::span<const Ray> rays, size_t begin, size_t end, bool always,
                           Query& query, std::vector<uint32_t>* odd) {
  const bool prefetch = scene.arrays.block.size() > kPrefetchBytes;
  bool sharing = always;
  size_t apart = begin, pause_end = begin;
  for (size_t at = begin; at < end; at += kStreamRays) {
    const auto stream = rays.subspan(at, std::min(kStreamRays, end - at));
    if (!sharing && (at < pause_end || !GoSameWay(stream))) continue;
    TraceApart(scene, rays, apart, at, kInFlight, query, odd);
    apart = at + stream.size();
    const auto first = static_cast<uint32_t>(at);
    const double share = prefetch ? StreamTraversal<Query, true>(scene, query, odd).Trace(stream, first)
                                  : StreamTraversal<Query, false>(scene, query, odd).Trace(stream, first);
    sharing = always || share >= kLeastShare;
    if (!sharing) pause_end = apart + kStreamPause;
  }
  TraceApart(scene, rays, apart, end, kInFlight, query, odd);
}

// Rays begin to end - 1, which are not traced in packets.
template <typename Query>
HWY_ATTR void TraceRest(const WideScene& scene, std::span<const Ray> rays, size_t begin, size_t end,
                        Traversal traversal, Query& query, std::vector<uint32_t>* odd) {
  if constexpr (!Query::kOrdered) {
    if (traversal == Traversal::kAuto || traversal == Traversal::kStream) {
      return TraceStreams(scene, rays, begin, end, traversal == Traversal::kStream, query, odd);
    }
  }
  TraceApart(scene, rays, begin, end, traversal == Traversal::kSingle ? 1 : kInFlight, query, odd);
}

template <typename Query>
HWY_ATTR void Trace(const WideScene& scene, std::span<const Ray> rays, Traversal traversal, Query& query,
                    std::vector<uint32_t>* odd) {
  using Packet = PacketTraversal<Query>;
  // Runs of rays that no packet takes are traced as they end.
  size_t rest = 0;
  if (traversal == Traversal::kAuto || traversal == Traversal::kPacket) {
    for (size_t begin = 0; begin + kPacketRays <= rays.size();) {
      const auto outcome =
          Packet(scene, query)
              .Trace(rays.subspan(begin, kPacketRays), static_cast<uint32_t>(begin), traversal == Traversal::kPacket);
      if (outcome == Packet::Outcome::kTraced) {
        TraceRest(scene, rays, rest, begin, traversal, query, odd);
        rest = begin + kPacketRays;
      }
      begin += outcome == Packet::Outcome::kGaveUp ? kPacketPause : kPacketRays;
    }
  }
  TraceRest(scene, rays, rest, rays.size(), traversal, query, odd);
}

// The kernels. `Traced::Of(query)` is what a query is traced as.

template <typename Traced>
HWY_ATTR void ClosestHits(const WideScene& scene, std::span<const Ray> rays, const QueryOptions& options,
                          std::span<Hit> hits, std::vector<uint32_t>* odd) {
  switch (options.accuracy) {
    case AccuracyLevel::kFast: {
      ClosestQuery<FastTest> query(options.culling, hits);
      auto&& traced = Traced::Of(query);
      return Trace(scene, rays, options.traversal, traced, odd);
    }
    case AccuracyLevel::kWatertight: {
      ClosestQuery<WatertightTest> query(options.culling, hits);
      auto&& traced = Traced::Of(query);
      return Trace(scene, rays, options.traversal, traced, odd);
    }
    case AccuracyLevel::kExact: {
      ExactClosestQuery query(scene, rays, options, hits);
      auto&& traced = Traced::Of(query);
      Trace(scene, rays, options.traversal, traced, odd);
      return query.Finish();
    }
  }
}

template <typename Traced>
HWY_ATTR void AnyHits(const WideScene& scene, std::span<const Ray> rays, const QueryOptions& options,
                      std::span<uint8_t> any, std::vector<uint32_t>* odd) {
  switch (options.accuracy) {
    case AccuracyLevel::kFast: {
      AnyQuery<FastTest> query(options.culling, any);
      auto&& traced = Traced::Of(query);
      return Trace(scene, rays, options.traversal, traced, odd);
    }
    case AccuracyLevel::kWatertight: {
      AnyQuery<WatertightTest> query(options.culling, any);
      auto&& traced = Traced::Of(query);
      return Trace(scene, rays, options.traversal, traced, odd);
    }
    case AccuracyLevel::kExact: {
      AnyDecider decider(scene, rays, options, any);
      ExactAnyQuery query(options.culling, decider);
      auto&& traced = Traced::Of(query);
      return Trace(scene, rays, options.traversal, traced, odd);
    }
  }
}

template <typename Traced>
HWY_ATTR bool Collect(const WideScene& scene, const Ray& ray, Collector& collector) {
  std::vector<uint32_t> odd;
  CollectQuery query(collector);
  auto&& traced = Traced::Of(query);
  TraceApart(scene, std::span(&ray, 1), 0, 1, 1, traced, &odd);
  return odd.empty();
}

template <typename Traced>
const RayKernels* Kernels() {
  static constexpr RayKernels kKernels{&ClosestHits<Traced>, &AnyHits<Traced>, &Collect<Traced>};
  return &kKernels;
}

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_RAY_KERNELS_INL_H_
