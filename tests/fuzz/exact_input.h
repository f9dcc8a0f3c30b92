// What a fuzzer's bytes stand for: a mesh, rays, a tree and a query.

#ifndef TESTS_FUZZ_EXACT_INPUT_H_
#define TESTS_FUZZ_EXACT_INPUT_H_

#include <cstdint>
#include <span>
#include <vector>

#include "server/build/config.h"
#include "server/geometry/ray.h"
#include "server/mesh/triangle_mesh.h"
#include "server/tree/simd_target.h"
#include "server/tree/tree.h"

namespace deltaray {

struct ExactInput {
  Config config;
  // Of the targets of this processor.
  SimdTarget target;
  QueryOptions options;
  TriangleMesh mesh;
  // In groups of neighbours that are long enough for packets and streams.
  std::vector<Ray> rays;
};

// Every sequence of bytes stands for a valid input: numbers that the server would refuse are replaced.
// REQUIRES: SupportedSimdTargets() is not empty.
ExactInput ReadExactInput(std::span<const uint8_t> bytes);

}  // namespace deltaray

#endif  // TESTS_FUZZ_EXACT_INPUT_H_
