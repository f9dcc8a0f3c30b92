// Which rays share packets, as the kernels see it.

#ifndef TESTS_PROPERTY_PACKET_COUNT_H_
#define TESTS_PROPERTY_PACKET_COUNT_H_

#include <cstddef>
#include <span>

#include "server/geometry/ray.h"
#include "server/tree/wide_arrays.h"

namespace deltaray {

// Rays of a packet.
inline constexpr size_t kRaysOfPacket = 16;

// How many of the groups of 16 rays, from the first on, the kernel of arrays.target takes for packets at kExact.
// `wide`: as Traversal::kPacket does, however wide apart rays are; else as kAuto does, until it gives up on packets.
size_t CountPackets(std::span<const Ray> rays, const WideArrays& arrays, bool wide);

}  // namespace deltaray

#endif  // TESTS_PROPERTY_PACKET_COUNT_H_
