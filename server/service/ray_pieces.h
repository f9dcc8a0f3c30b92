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
#include "server/service/batch_control.h"
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
  // The time after which a slice is given up, and its rays come again, fewer at once; one ray may take any time.
  static constexpr std::chrono::milliseconds Patience(size_t rays) {
    return rays > 1 ? 4 * kSliceTime : std::chrono::milliseconds::max();
  }
  void NoteGivenUp(size_t rays) { rays_.store(std::max<size_t>(rays / kCut, 1), std::memory_order_relaxed); }
  void Note(size_t rays, std::chrono::steady_clock::duration time) {
    const double parts = std::max<double>(static_cast<double>(time.count()), 1.0) /
                         std::chrono::duration_cast<std::chrono::steady_clock::duration>(kSliceTime).count();
    const double fitting = static_cast<double>(rays) / std::max(parts, 1 / kGrowth);
    rays_.store(static_cast<size_t>(std::clamp(fitting, 1.0, double{RayBatchView::kMaxPieceRays})),
                std::memory_order_relaxed);
  }

 private:
  // A cancelled batch ends, and others get their turn, after about as long.
  static constexpr std::chrono::milliseconds kSliceTime{10};
  // Where fast and slow rays come in turns, most slices must not be given up.
  static constexpr size_t kCut = 16;
  static constexpr double kGrowth = 4;
  std::atomic<size_t> rays_;
};

// Whether a slice is to end before all of its rays are traced.
class SliceEnd {
 public:
  using Clock = std::chrono::steady_clock;

  // After `patience`, or once `cancelled` returns true.
  SliceEnd(const std::function<bool()>& cancelled, std::chrono::milliseconds patience)
      : cancelled_(cancelled), patience_(patience), asked_([this] { return came_ = came_ || Comes(); }) {}
  SliceEnd(const SliceEnd&) = delete;
  SliceEnd& operator=(const SliceEnd&) = delete;

  // For QueryOptions::stopped.
  const std::function<bool()>* asked() const { return &asked_; }
  // Whether a query was told to end: what it has written is of no meaning then.
  bool came() const { return came_; }

  Clock::duration time() const { return Clock::now() - start_; }

 private:
  bool Comes() const { return cancelled_() || (patience_ != patience_.max() && time() > patience_); }

  const std::function<bool()>& cancelled_;
  const std::chrono::milliseconds patience_;
  const Clock::time_point start_ = Clock::now();
  bool came_ = false;
  const std::function<bool()> asked_;
};

// Decodes `batch` piece by piece and calls trace(first, std::span<const Ray>, const SliceEnd&) for each, which returns
// a status, spread over the arena of the calling thread. A piece comes in slices, one after the other, of `first_slice`
// rays to begin with and then of as many as take about kSliceTime: `trace` is called for each, and again, with fewer
// rays, where it found that the slice's end had come before it had traced them. Returns the first failure; CANCELLED
// soon after control.cancelled returns true. REQUIRES: piece_rays <= RayBatchView::kMaxPieceRays.
template <typename Trace>
absl::Status ForRayPieces(const RayBatchView& batch, size_t piece_rays, const BatchControl& control, const Trace& trace,
                          size_t first_slice = RayBatchView::kMaxPieceRays) {
  FirstFailure failure;
  RayTimer timer(first_slice);
  Tracer::ForPieces(batch.size(), piece_rays, [&](size_t first, size_t last) {
    if (!failure.Matters(first)) return;
    absl::Status status = CatchExceptions([&]() -> absl::Status {
      control.pause();
      if (control.cancelled()) return absl::CancelledError("cancelled");
      PieceArray<Ray> rays(last - first);
      if (absl::Status decoded = batch.Decode(first, rays); !decoded.ok()) return decoded;
      const std::span<const Ray> piece = rays;
      for (size_t done = 0;;) {
        const size_t slice = std::min(timer.SliceRays(), piece.size() - done);
        const SliceEnd end(control.cancelled, RayTimer::Patience(slice));
        if (absl::Status traced = trace(first + done, piece.subspan(done, slice), end); !traced.ok()) return traced;
        if (end.came()) {
          timer.NoteGivenUp(slice);
        } else {
          timer.Note(slice, end.time());
          done += slice;
          if (done == piece.size()) break;
        }
        control.pause();
        if (control.cancelled()) return absl::CancelledError("cancelled");
      }
      return absl::OkStatus();
    });
    if (!status.ok()) failure.Note(first, std::move(status));
  });
  return failure.status();
}

}  // namespace deltaray

#endif  // SERVER_SERVICE_RAY_PIECES_H_
