// One way to answer rays, as benchmarks call it: an engine, the call it is asked by, and how accurate it is.

#ifndef TESTS_BENCH_KERNEL_H_
#define TESTS_BENCH_KERNEL_H_

#include <memory>
#include <span>

#include "server/geometry/ray.h"
#include "server/tree/tree.h"

namespace deltaray {

// What is asked of each ray.
enum class Question { kClosestHit, kAnyHit };

// Thread-safe: any number of workers may be at work at once.
class Kernel {
 public:
  // The state of one thread: a chunk of rays and its answers, in the layout that the engine works on. So every engine
  // is timed on rays that are where it wants them, in the cache, as after the decoding of a request.
  class Worker {
   public:
    virtual ~Worker() = default;
    virtual void Load(std::span<const Ray> rays) = 0;
    // Answers the rays that were loaded last. This alone is timed. May be called once for each Load.
    virtual void Trace() = 0;
    // hits[i]: what ray i of the chunk hits. With kAnyHit only t is filled in: 0 for a hit, +infinity for a miss.
    virtual void Store(std::span<Hit> hits) const = 0;
  };

  virtual ~Kernel() = default;
  // Workers must not outlive the kernel. They take chunks of up to `max_rays` rays.
  virtual std::unique_ptr<Worker> MakeWorker(size_t max_rays) const = 0;
};

// Asks `tree`, which must outlive the kernel, by `options`.
std::unique_ptr<Kernel> MakeDeltarayKernel(const Tree& tree, const QueryOptions& options, Question question);

}  // namespace deltaray

#endif  // TESTS_BENCH_KERNEL_H_
