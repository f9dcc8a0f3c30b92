#include "server/tree/simd_target.h"

#include "hwy/targets.h"

namespace deltaray {

const std::vector<SimdTarget>& SupportedSimdTargets() {
  static const std::vector<SimdTarget> targets = [] {
    const int64_t supported = hwy::SupportedTargets();
    std::vector<SimdTarget> found;
    if (supported & HWY_SSE4) found.push_back(SimdTarget::kSse4);
    if (supported & HWY_AVX2) found.push_back(SimdTarget::kAvx2);
    if (supported & HWY_AVX3) found.push_back(SimdTarget::kAvx512);
    return found;
  }();
  return targets;
}

const char* Name(SimdTarget target) {
  switch (target) {
    case SimdTarget::kSse4:
      return "sse4";
    case SimdTarget::kAvx2:
      return "avx2";
    case SimdTarget::kAvx512:
      return "avx512";
  }
  return "";
}

}  // namespace deltaray
