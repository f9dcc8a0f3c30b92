#include "tests/bench/kernel_run.h"

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <memory>
#include <thread>
#include <tuple>
#include <vector>

#include "tests/bench/measure.h"

namespace deltaray {

double TraceAll(const Kernel& kernel, std::span<const Ray> rays, uint32_t threads, size_t chunk, std::span<Hit> hits) {
  std::atomic<size_t> next{0};
  std::vector<double> seconds(threads, 0);
  const auto work = [&](uint32_t thread) {
    const std::unique_ptr<Kernel::Worker> worker = kernel.MakeWorker(chunk);
    for (size_t first; (first = next.fetch_add(chunk)) < rays.size();) {
      const size_t count = std::min(chunk, rays.size() - first);
      worker->Load(rays.subspan(first, count));
      const double start = ThreadCpuSeconds();
      worker->Trace();
      seconds[thread] += ThreadCpuSeconds() - start;
      worker->Store(hits.subspan(first, count));
    }
  };
  std::vector<std::thread> others;
  for (uint32_t thread = 1; thread < threads; ++thread) others.emplace_back(work, thread);
  work(0);
  for (std::thread& other : others) other.join();
  double sum = 0;
  for (const double s : seconds) sum += s;
  return sum;
}

double MegaraysPerSecond(size_t rays, uint32_t threads, double cpu_seconds) {
  return 1e-6 * static_cast<double>(rays) * threads / cpu_seconds;
}

size_t CountDisagreements(std::span<const Hit> hits, std::span<const Hit> expected, float tolerance) {
  size_t count = 0;
  for (size_t i = 0; i < hits.size(); ++i) {
    const float a = hits[i].t, b = expected[i].t;
    if (std::isinf(a) || std::isinf(b)) {
      count += std::isinf(a) != std::isinf(b);
    } else {
      count += !(std::abs(a - b) <= tolerance * std::max(std::abs(a), std::abs(b)));
    }
  }
  return count;
}

size_t CountDifferences(std::span<const Hit> hits, std::span<const Hit> expected) {
  const auto bits = [](const Hit& hit) {
    return std::tuple(std::bit_cast<uint32_t>(hit.t), std::bit_cast<uint32_t>(hit.u), std::bit_cast<uint32_t>(hit.v),
                      hit.primitive, hit.back);
  };
  size_t count = 0;
  for (size_t i = 0; i < hits.size(); ++i) count += bits(hits[i]) != bits(expected[i]);
  return count;
}

}  // namespace deltaray
