#include "tests/property/packet_count.h"

// As in ray_kernels.cc.
#define HWY_DISABLED_TARGETS (HWY_SSSE3 | HWY_AVX3_DL)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "tests/property/packet_count.cc"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#if HWY_TARGET == HWY_SSE4 || HWY_TARGET == HWY_AVX2 || HWY_TARGET == HWY_AVX3

#include "server/tree/packet_bounds-inl.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {
namespace {

// A type of its own, so that the linker does not take this file's PacketBounds for the kernels'.
struct Setup : RaySetup<true> {
  using RaySetup::RaySetup;
};

}  // namespace

HWY_ATTR size_t CountPackets(std::span<const Ray> rays, const WideArrays& arrays, bool wide) {
  static_assert(kRaysOfPacket == kPacketRays);
  const Setup setup(arrays);
  size_t packets = 0;
  for (size_t begin = 0; begin + kPacketRays <= rays.size(); begin += kPacketRays) {
    packets += PacketBounds<Setup>().Find(rays.subspan(begin, kPacketRays), setup, wide);
  }
  return packets;
}

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif

#if HWY_ONCE

namespace deltaray {

size_t CountPackets(std::span<const Ray> rays, const WideArrays& arrays, bool wide) {
  switch (arrays.target) {
    case SimdTarget::kSse4:
      break;
    case SimdTarget::kAvx2:
      return N_AVX2::CountPackets(rays, arrays, wide);
    case SimdTarget::kAvx512:
      return N_AVX3::CountPackets(rays, arrays, wide);
  }
  return N_SSE4::CountPackets(rays, arrays, wide);
}

}  // namespace deltaray

#endif  // HWY_ONCE
