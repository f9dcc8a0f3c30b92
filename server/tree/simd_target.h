// The vector instructions that a wide tree is laid out for and traversed with.

#ifndef SERVER_TREE_SIMD_TARGET_H_
#define SERVER_TREE_SIMD_TARGET_H_

#include <cstdint>
#include <vector>

namespace deltaray {

// In order of width. A node of a wide tree has as many lanes as a register has floats: 4, 8, 16.
enum class SimdTarget : uint8_t { kSse4, kAvx2, kAvx512 };

// Lanes of a node.
constexpr int Width(SimdTarget target) { return 4 << static_cast<int>(target); }

// Those that this processor runs, the widest last. Empty on a processor without SSE4.2.
const std::vector<SimdTarget>& SupportedSimdTargets();

const char* Name(SimdTarget target);

}  // namespace deltaray

#endif  // SERVER_TREE_SIMD_TARGET_H_
