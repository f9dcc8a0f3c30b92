// A batch of rays, worked on piece by piece over the threads of the tracer.

#ifndef SERVER_SERVICE_RAY_PIECES_H_
#define SERVER_SERVICE_RAY_PIECES_H_

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <new>
#include <span>
#include <type_traits>
#include <utility>

#include "absl/status/status.h"
#include "server/build/mutex.h"
#include "server/geometry/ray.h"
#include "server/service/ray_batch.h"
#include "server/service/rpc_status.h"
#include "server/service/tracer.h"

namespace deltaray {

// Room on the stack for what a piece has of `T`, as many as its rays, each of which is written before it is read: the
// defaults of 1024 rays would be 36 KB to write, for a call of one ray too.
template <typename T>
class PieceArray {
 public:
  static_assert(std::is_trivially_copyable_v<T> && std::is_trivially_destructible_v<T>);

  explicit PieceArray(size_t size) : size_(size) {}
  operator std::span<T>() { return {std::launder(reinterpret_cast<T*>(bytes_)), size_}; }
  operator std::span<const T>() { return std::span<T>(*this); }

 private:
  const size_t size_;
  alignas(T) std::byte bytes_[RayBatchView::kMaxPieceRays * sizeof(T)];
};

// The first failure by index of ray, of pieces that fail in any order.
class FirstFailure {
 public:
  // Whether the piece that begins at `first` still matters.
  bool Matters(size_t first) const { return first < first_.load(std::memory_order_relaxed); }

  void Note(size_t first, absl::Status status) {
    MutexLock lock(mutex_);
    if (first >= first_.load(std::memory_order_relaxed)) return;
    first_.store(first, std::memory_order_relaxed);
    status_ = std::move(status);
  }

  absl::Status status() {
    MutexLock lock(mutex_);
    return status_;
  }

 private:
  std::atomic<size_t> first_{SIZE_MAX};
  Mutex mutex_;
  absl::Status status_ ABSL_GUARDED_BY(mutex_);
};

// Rays of a piece of a batch of `rays`: all cores have work from the start, and end at about the same time.
inline size_t PieceRays(size_t rays) {
  // Enough to make the cost of a task vanish and to keep many rays in flight, few enough that a cancelled batch ends
  // soon, and that all of a piece stays in the cache.
  constexpr size_t kMinPieceRays = 256;
  constexpr size_t kMaxPieceRays = RayBatchView::kMaxPieceRays;
  // Pieces for each core, where a batch has rays for that many.
  constexpr size_t kPiecesPerCore = 4;
  return std::clamp(rays / (kPiecesPerCore * Tracer::Concurrency()), kMinPieceRays, kMaxPieceRays);
}

// Decodes `batch` piece by piece and calls trace(first, std::span<const Ray>), which returns a status, for each, spread
// over the arena of the calling thread. Returns the first failure; CANCELLED soon after `cancelled` returns true, which
// is asked for every piece. REQUIRES: piece_rays <= RayBatchView::kMaxPieceRays.
template <typename Trace>
absl::Status ForRayPieces(const RayBatchView& batch, size_t piece_rays, const std::function<bool()>& cancelled,
                          const Trace& trace) {
  FirstFailure failure;
  Tracer::ForPieces(batch.size(), piece_rays, [&](size_t first, size_t last) {
    if (!failure.Matters(first)) return;
    absl::Status status = CatchExceptions([&]() -> absl::Status {
      if (cancelled()) return absl::CancelledError("cancelled");
      PieceArray<Ray> rays(last - first);
      if (absl::Status decoded = batch.Decode(first, rays); !decoded.ok()) return decoded;
      return trace(first, std::span<const Ray>(rays));
    });
    if (!status.ok()) failure.Note(first, std::move(status));
  });
  return failure.status();
}

}  // namespace deltaray

#endif  // SERVER_SERVICE_RAY_PIECES_H_
