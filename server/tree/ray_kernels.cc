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
#include "server/tree/queries-inl.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {
namespace {

// Enough to hide the time that memory takes.
constexpr size_t kInFlight = 32;

template <typename Query>
HWY_ATTR void Trace(const WideScene& scene, std::span<const Ray> rays, Traversal traversal, Query& query,
                    std::vector<uint32_t>* odd) {
  const size_t in_flight = traversal == Traversal::kSingle ? 1 : kInFlight;
  if (scene.arrays.block.size() > kPrefetchBytes) {
    BatchTraversal<Query, true>(scene, rays, query, in_flight, odd).Run();
  } else {
    BatchTraversal<Query, false>(scene, rays, query, in_flight, odd).Run();
  }
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
      ClosestDecider decider(scene, rays, options, hits);
      ExactClosestQuery query(scene, options.culling, decider);
      return Trace(scene, rays, options.traversal, query, odd);
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
  Trace(scene, std::span(&ray, 1), Traversal::kSingle, query, &odd);
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
