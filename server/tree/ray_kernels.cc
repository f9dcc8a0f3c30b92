#include "server/tree/ray_kernels.h"

#include "server/tree/suspects.h"

// Only these are of use: SSSE3 processors without SSE4.2 are gone, and what AVX-512 got later brings nothing here.
#define HWY_DISABLED_TARGETS (HWY_SSSE3 | HWY_AVX3_DL)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "server/tree/ray_kernels.cc"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

// The target that the compiler was told to build for anyway has no registers worth the name.
#if HWY_TARGET == HWY_SSE4 || HWY_TARGET == HWY_AVX2 || HWY_TARGET == HWY_AVX3

#include "server/tree/batch_traversal-inl.h"
#include "server/tree/packet_traversal-inl.h"
#include "server/tree/queries-inl.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {
namespace {

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

template <typename Query>
HWY_ATTR void Trace(const WideScene& scene, std::span<const Ray> rays, Traversal traversal, Query& query,
                    std::vector<uint32_t>* odd) {
  if (traversal == Traversal::kSingle || traversal == Traversal::kBatch) {
    return TraceApart(scene, rays, 0, rays.size(), traversal == Traversal::kSingle ? 1 : kInFlight, query, odd);
  }
  // Runs of rays that no packet takes are traced as they end.
  size_t apart = 0;
  for (size_t begin = 0; begin + kPacketRays <= rays.size(); begin += kPacketRays) {
    if (!PacketTraversal<Query>(scene, query)
             .Trace(rays.subspan(begin, kPacketRays), static_cast<uint32_t>(begin), traversal == Traversal::kPacket)) {
      continue;
    }
    TraceApart(scene, rays, apart, begin, kInFlight, query, odd);
    apart = begin + kPacketRays;
  }
  TraceApart(scene, rays, apart, rays.size(), kInFlight, query, odd);
}

HWY_ATTR void ClosestHits(const WideScene& scene, std::span<const Ray> rays, const QueryOptions& options,
                          std::span<Hit> hits, std::vector<uint32_t>* odd) {
  switch (options.accuracy) {
    case AccuracyLevel::kFast: {
      ClosestQuery<FastTest> query(options.culling, hits);
      return Trace(scene, rays, options.traversal, query, odd);
    }
    case AccuracyLevel::kWatertight: {
      ClosestQuery<WatertightTest> query(options.culling, hits);
      return Trace(scene, rays, options.traversal, query, odd);
    }
    case AccuracyLevel::kExact: {
      ExactClosestQuery query(scene, rays, options, hits);
      Trace(scene, rays, options.traversal, query, odd);
      return query.Finish();
    }
  }
}

HWY_ATTR void AnyHits(const WideScene& scene, std::span<const Ray> rays, const QueryOptions& options,
                      std::span<uint8_t> any, std::vector<uint32_t>* odd) {
  switch (options.accuracy) {
    case AccuracyLevel::kFast: {
      AnyQuery<FastTest> query(options.culling, any);
      return Trace(scene, rays, options.traversal, query, odd);
    }
    case AccuracyLevel::kWatertight: {
      AnyQuery<WatertightTest> query(options.culling, any);
      return Trace(scene, rays, options.traversal, query, odd);
    }
    case AccuracyLevel::kExact: {
      AnyDecider decider(scene, rays, options, any);
      ExactAnyQuery query(options.culling, decider);
      return Trace(scene, rays, options.traversal, query, odd);
    }
  }
}

HWY_ATTR bool Collect(const WideScene& scene, const Ray& ray, Collector& collector) {
  std::vector<uint32_t> odd;
  CollectQuery query(collector);
  TraceApart(scene, std::span(&ray, 1), 0, 1, 1, query, &odd);
  return odd.empty();
}

}  // namespace

const RayKernels* Kernels() {
  static constexpr RayKernels kKernels{&ClosestHits, &AnyHits, &Collect};
  return &kKernels;
}

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif

#if HWY_ONCE

namespace deltaray {

const RayKernels& KernelsOf(SimdTarget target) {
  switch (target) {
    case SimdTarget::kSse4:
      break;
    case SimdTarget::kAvx2:
      return *N_AVX2::Kernels();
    case SimdTarget::kAvx512:
      return *N_AVX3::Kernels();
  }
  return *N_SSE4::Kernels();
}

}  // namespace deltaray

#endif  // HWY_ONCE
