// The kernels that trace rays through a wide tree, compiled for each SimdTarget.

#ifndef SERVER_TREE_RAY_KERNELS_H_
#define SERVER_TREE_RAY_KERNELS_H_

#include <cstdint>
#include <span>
#include <vector>

#include "server/geometry/ray.h"
#include "server/geometry/triangles.h"
#include "server/tree/collector.h"
#include "server/tree/stop_poll.h"
#include "server/tree/tree.h"
#include "server/tree/wide_arrays.h"

namespace deltaray {

// What all kernels read, and whom they ask whether to go on.
struct WideScene {
  const WideArrays& arrays;
  const TrianglesView& triangles;
  StopPoll& stop;
};

// One target's kernels. Those that answer whole batches write an answer for every ray but the `odd` ones: those whose
// origin or direction is so large or small that the tree's frame does not suit them, which the caller has to trace one
// by one; there, nothing is written. Thread-safe; the tree's target must be the kernels'. Throw std::bad_alloc.
struct RayKernels {
  void (*closest_hits)(const WideScene& scene, std::span<const Ray> rays, const QueryOptions& options,
                       std::span<Hit> hits, std::vector<uint32_t>* odd);
  void (*any_hits)(const WideScene& scene, std::span<const Ray> rays, const QueryOptions& options,
                   std::span<uint8_t> any, std::vector<uint32_t>* odd);
  // Brings the triangles that the ray may hit to the collector, near ones first, as long as it wants them. Returns
  // false, and brings none, where the ray is odd.
  bool (*collect)(const WideScene& scene, const Ray& ray, Collector& collector);
};

// REQUIRES: this processor supports `target`.
const RayKernels& KernelsOf(SimdTarget target);

// The same, for threads that have a LeafRecorder, which they tell of each leaf that they test. Compiled apart, so that
// the compiler's choices for the plain ones stay the same.
const RayKernels& RecordingKernelsOf(SimdTarget target);

}  // namespace deltaray

#endif  // SERVER_TREE_RAY_KERNELS_H_
