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

#include "server/tree/ray_kernels-inl.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

struct AsItIs {
  template <typename Query>
  static Query& Of(Query& query) {
    return query;
  }
};

const RayKernels* PlainKernels() { return Kernels<AsItIs>(); }

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
      return *N_AVX2::PlainKernels();
    case SimdTarget::kAvx512:
      return *N_AVX3::PlainKernels();
  }
  return *N_SSE4::PlainKernels();
}

}  // namespace deltaray

#endif  // HWY_ONCE
