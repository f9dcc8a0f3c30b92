// The kernels of RayKernels, for one target.

#if defined(SERVER_TREE_RAY_KERNELS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_RAY_KERNELS_INL_H_
#undef SERVER_TREE_RAY_KERNELS_INL_H_
#else
#define SERVER_TREE_RAY_KERNELS_INL_H_
#endif

#include <cstddef>
#include <cstdint>
#include <span>
#include <type_traits>
#include <vector>

#include "hwy/highway.h"
#include "server/tree/batch_traversal-inl.h"
#include "server/tree/packet_traversal-inl.h"
#include "server/tree/queries-inl.h"
#include "server/tree/ray_kernels.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

// Rays begin to end - 1, each on its own.
template <typename Query>
HWY_ATTR void TraceApart(const WideScene& scene, std::span<const Ray> rays, size_t begin, size_t end, size_t in_flight,
                         Query&& query, std::vector<uint32_t>* odd) {
  if (begin == end) return;
  if (scene.arrays.block.size() > kPrefetchBytes) {
    BatchTraversal<std::remove_reference_t<Query>, true>(scene, rays, begin, end, query, in_flight, odd).Run();
  } else {
    BatchTraversal<std::remove_reference_t<Query>, false>(scene, rays, begin, end, query, in_flight, odd).Run();
  }
}

template <typename Query>
HWY_ATTR void Trace(const WideScene& scene, std::span<const Ray> rays, Traversal traversal, Query&& query,
                    std::vector<uint32_t>* odd) {
  if (traversal == Traversal::kSingle || traversal == Traversal::kBatch) {
    return TraceApart(scene, rays, 0, rays.size(), traversal == Traversal::kSingle ? 1 : kInFlight, query, odd);
  }
  // Runs of rays that no packet takes are traced as they end.
  size_t apart = 0;
  for (size_t begin = 0; begin + kPacketRays <= rays.size(); begin += kPacketRays) {
    if (!PacketTraversal<std::remove_reference_t<Query>>(scene, query)
             .Trace(rays.subspan(begin, kPacketRays), static_cast<uint32_t>(begin), traversal == Traversal::kPacket)) {
      continue;
    }
    TraceApart(scene, rays, apart, begin, kInFlight, query, odd);
    apart = begin + kPacketRays;
  }
  TraceApart(scene, rays, apart, rays.size(), kInFlight, query, odd);
}

// `Traced::Of(query)` is what a query is traced as.

template <typename Traced>
HWY_ATTR void ClosestHits(const WideScene& scene, std::span<const Ray> rays, const QueryOptions& options,
                          std::span<Hit> hits, std::vector<uint32_t>* odd) {
  switch (options.accuracy) {
    case AccuracyLevel::kFast: {
      ClosestQuery<FastTest> query(options.culling, hits);
      return Trace(scene, rays, options.traversal, Traced::Of(query), odd);
    }
    case AccuracyLevel::kWatertight: {
      ClosestQuery<WatertightTest> query(options.culling, hits);
      return Trace(scene, rays, options.traversal, Traced::Of(query), odd);
    }
    case AccuracyLevel::kExact: {
      ExactClosestQuery query(scene, rays, options, hits);
      Trace(scene, rays, options.traversal, Traced::Of(query), odd);
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
      return Trace(scene, rays, options.traversal, Traced::Of(query), odd);
    }
    case AccuracyLevel::kWatertight: {
      AnyQuery<WatertightTest> query(options.culling, any);
      return Trace(scene, rays, options.traversal, Traced::Of(query), odd);
    }
    case AccuracyLevel::kExact: {
      AnyDecider decider(scene, rays, options, any);
      ExactAnyQuery query(options.culling, decider);
      return Trace(scene, rays, options.traversal, Traced::Of(query), odd);
    }
  }
}

template <typename Traced>
HWY_ATTR bool Collect(const WideScene& scene, const Ray& ray, Collector& collector) {
  std::vector<uint32_t> odd;
  CollectQuery query(collector);
  TraceApart(scene, std::span(&ray, 1), 0, 1, 1, Traced::Of(query), &odd);
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
