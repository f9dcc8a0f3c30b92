// A batch of rays, worked on piece by piece over the threads of the tracer.

#ifndef SERVER_SERVICE_RAY_PIECES_H_
#define SERVER_SERVICE_RAY_PIECES_H_

#include <algorithm>
#include <atomic>
#include <chrono>
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

// Times the rays of a batch, for pieces of rays that take long to be cut. Thread-safe.
class RayTimer {
 public:
  // `first_rays`: to begin with, while nothing is known.
  explicit RayTimer(size_t first_rays) : rays_(first_rays) {}

  // Rays that take about kSliceTime.
  size_t SliceRays() const { return rays_.load(std::memory_order_relaxed); }
  void Note(size_t rays, std::chrono::steady_clock::duration time) {
    const double parts = std::max<double>(static_cast<double>(time.count()), 1.0) /
                         std::chrono::duration_cast<std::chrono::steady_clock::duration>(kSliceTime).count();
    const double fitting = static_cast<double>(rays) / parts;
    rays_.store(static_cast<size_t>(std::clamp(fitting, 1.0, double{RayBatchView::kMaxPieceRays})),
                std::memory_order_relaxed);
  }

 private:
  // A cancelled batch ends, and others get their turn, after about as long.
  static constexpr std::chrono::milliseconds kSliceTime{10};
  std::atomic<size_t> rays_;
};

// Decodes `batch` piece by piece and calls trace(first, std::span<const Ray>), which returns a status, for each, spread
// over the arena of the calling thread. A piece comes in slices, one after the other, of `first_slice` rays to begin
// with and then of as many as take about kSliceTime: `trace` is called for each. Returns the first failure; CANCELLED
// soon after `cancelled` returns true, which is asked before every slice. REQUIRES: piece_rays <=
// RayBatchView::kMaxPieceRays.
template <typename Trace>
absl::Status ForRayPieces(const RayBatchView& batch, size_t piece_rays, const std::function<bool()>& cancelled,
                          const Trace& trace, size_t first_slice = RayBatchView::kMaxPieceRays) {
  FirstFailure failure;
  RayTimer timer(first_slice);
  Tracer::ForPieces(batch.size(), piece_rays, [&](size_t first, size_t last) {
    if (!failure.Matters(first)) return;
    absl::Status status = CatchExceptions([&]() -> absl::Status {
      if (cancelled()) return absl::CancelledError("cancelled");
      PieceArray<Ray> rays(last - first);
      if (absl::Status decoded = batch.Decode(first, rays); !decoded.ok()) return decoded;
      const std::span<const Ray> piece = rays;
      for (size_t done = 0; done < piece.size();) {
        if (done > 0 && cancelled()) return absl::CancelledError("cancelled");
        const size_t slice = std::min(timer.SliceRays(), piece.size() - done);
        const auto start = std::chrono::steady_clock::now();
        if (absl::Status traced = trace(first + done, piece.subspan(done, slice)); !traced.ok()) return traced;
        timer.Note(slice, std::chrono::steady_clock::now() - start);
        done += slice;
      }
      return absl::OkStatus();
    });
    if (!status.ok()) failure.Note(first, std::move(status));
  });
  return failure.status();
}

}  // namespace deltaray

#endif  // SERVER_SERVICE_RAY_PIECES_H_
