// One timed pass of a kernel over a set of rays.

#ifndef TESTS_BENCH_KERNEL_RUN_H_
#define TESTS_BENCH_KERNEL_RUN_H_

#include <cstddef>
#include <cstdint>
#include <span>

#include "server/geometry/ray.h"
#include "tests/bench/kernel.h"

namespace deltaray {

// Rays that a thread takes at once where nothing else is asked for.
inline constexpr size_t kChunk = 1024;

// Answers `rays` in chunks of `chunk` on `threads` threads, each of which takes the next chunk once it is done with
// one. Returns the processor seconds of all threads within Kernel::Worker::Trace: what other processes take of the
// machine does not count. hits[i]: as Kernel::Worker::Store tells.
double TraceAll(const Kernel& kernel, std::span<const Ray> rays, uint32_t threads, size_t chunk, std::span<Hit> hits);

// Rays per second and thread in millions, of a pass that took `cpu_seconds`, times the threads: the speed that the pass
// would have on as many cores of its own.
double MegaraysPerSecond(size_t rays, uint32_t threads, double cpu_seconds);

// Number of rays of which the t of `hits` and `expected` differ: one is a miss and the other a hit, or they differ by
// more than `tolerance`, relative to the larger one.
size_t CountDisagreements(std::span<const Hit> hits, std::span<const Hit> expected, float tolerance);

// Number of rays of which `hits` and `expected` differ in any bit: of t, primitive, u, v or side.
size_t CountDifferences(std::span<const Hit> hits, std::span<const Hit> expected);

}  // namespace deltaray

#endif  // TESTS_BENCH_KERNEL_RUN_H_
