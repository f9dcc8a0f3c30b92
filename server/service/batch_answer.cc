#include "server/service/batch_answer.h"

#include <algorithm>
#include <atomic>
#include <numeric>
#include <span>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/service/hit_columns.h"
#include "server/service/ray_batch.h"
#include "server/service/ray_pieces.h"
#include "server/service/tracer.h"

namespace deltaray {
namespace {

// A piece of ALL_HITS finds at most this many hits, so that it neither takes long nor much memory.
constexpr size_t kPieceHits = size_t{1} << 20;
constexpr size_t kSmallBatchRays = 256;
constexpr size_t kShortBatchRays = 16384;
// Rays of a batch whose time is taken first.
constexpr size_t kFirstSlice = 16;
// Bytes of a request or reply besides its arrays, at most: ids, numbers, tags and lengths.
constexpr uint64_t kOverheadBytes = 512;

absl::Status ReplyTooLarge(uint64_t limit) {
  return absl::ResourceExhaustedError(absl::StrCat("the reply is over the limit of ", limit,
                                                   " bytes a message (--max-message-bytes); send smaller batches"));
}

// See Tree::answered_accuracy.
AccuracyLevel AnsweredAccuracy(const Tree& tree, const BatchQuery& query) {
  const bool one_hit = query.kind == v1::QUERY_KIND_CLOSEST_HIT || query.kind == v1::QUERY_KIND_ANY_HIT;
  return one_hit ? tree.answered_accuracy(query.options.accuracy) : AccuracyLevel::kExact;
}

// Whether all hits of each ray are looked for: one ray may have more work than a small batch of others.
bool HasAllHits(const BatchQuery& query) {
  return query.kind == v1::QUERY_KIND_ALL_HITS || query.kind == v1::QUERY_KIND_COUNT_HITS;
}

// Whether a message of `bytes` holds about `rays` rays at most.
bool HoldsRays(const BatchQuery& query, size_t bytes, size_t rays) {
  return bytes <= rays * (query.RayBytes() + sizeof(uint32_t)) + kOverheadBytes;
}

// The sum of hits(row).
template <typename Row, typename Hits>
uint64_t Sum(std::span<const Row> rows, const Hits& hits) {
  uint64_t sum = 0;
  for (const Row& row : rows) sum += hits(row);
  return sum;
}

// One batch while it is answered.
class Answering {
 public:
  Answering(const TreeSnapshot& snapshot, const BatchQuery& query, const RayBatchView& rays, const BatchLimits& limits,
            const BatchControl& control)
      : mesh_(*snapshot.mesh),
        tree_(*snapshot.tree),
        query_(query),
        rays_(rays),
        limits_(limits),
        control_(control),
        summary_{AnsweredAccuracy(*snapshot.tree, query), snapshot.final} {}

  // All kinds but ALL_HITS: one row a ray, written where it belongs at once.
  absl::StatusOr<BatchAnswer> TraceRows() {
    std::atomic<uint64_t> hits_in_all{0};
    HitColumns columns(query_, rays_.size(), rays_.size(), summary_);
    absl::Status status = ForRayPieces(
        rays_, PieceRays(rays_.size()), control_,
        [&](size_t first, std::span<const Ray> rays, const SliceEnd& end) {
          const QueryOptions options = OptionsFor(end);
          switch (query_.kind) {
            case v1::QUERY_KIND_ANY_HIT: {
              PieceArray<uint8_t> any(rays.size());
              tree_.AnyHits(rays, options, any);
              if (end.came()) break;
              columns.WriteAny(first, any);
              hits_in_all += Sum<uint8_t>(any, [](uint8_t hit) { return uint64_t{hit != 0}; });
              break;
            }
            case v1::QUERY_KIND_COUNT_HITS: {
              PieceArray<uint32_t> counts(rays.size());
              tree_.CountHits(rays, options, counts);
              if (end.came()) break;
              columns.WriteCounts(first, counts);
              hits_in_all += Sum<uint32_t>(counts, [](uint32_t count) { return uint64_t{count}; });
              break;
            }
            default: {
              PieceArray<Hit> hits(rays.size());
              tree_.ClosestHits(rays, options, hits);
              if (end.came()) break;
              columns.WriteHits(first, hits, mesh_);
              hits_in_all += Sum<Hit>(hits, [](const Hit& hit) { return uint64_t{hit.IsHit()}; });
            }
          }
          return absl::OkStatus();
        },
        FirstSlice());
    if (!status.ok()) return status;
    return Answer(columns, hits_in_all);
  }

  // ALL_HITS: where the rows of a piece belong is known once all hits are found.
  absl::StatusOr<BatchAnswer> TraceAllHits() {
    const size_t piece_rays =
        std::clamp<size_t>(kPieceHits / query_.options.max_hits_per_ray, 1, PieceRays(rays_.size()));
    std::vector<std::vector<Hit>> hits((rays_.size() + piece_rays - 1) / piece_rays);
    std::vector<uint32_t> offsets(rays_.size() + 1);
    std::vector<uint32_t> counts(query_.Wants(v1::HIT_COLUMN_COUNT) ? rays_.size() : 0);
    std::atomic<uint64_t> hits_in_all{0};
    const uint64_t max_hits = MaxHits();
    absl::Status status = ForRayPieces(
        rays_, piece_rays, control_,
        [&](size_t first, std::span<const Ray> rays, const SliceEnd& end) -> absl::Status {
          const QueryOptions options = OptionsFor(end);
          std::vector<Hit>& found = hits[first / piece_rays];
          // For now the number of hits of each ray; their sums follow below.
          const std::span<uint32_t> rows = std::span(offsets).subspan(first + 1, rays.size());
          const size_t before = found.size();  // of the slices before
          tree_.AllHits(rays, options, &found, rows);
          if (!end.came() && !counts.empty()) {
            const std::span<uint32_t> piece_counts = std::span(counts).subspan(first, rays.size());
            std::copy(rows.begin(), rows.end(), piece_counts.begin());
            CountBeyondCap(rays, options, piece_counts);
          }
          if (end.came()) {
            found.resize(before);
            return absl::OkStatus();
          }
          const uint64_t added = found.size() - before;
          if (hits_in_all.fetch_add(added, std::memory_order_relaxed) + added > max_hits) {
            return ReplyTooLarge(limits_.max_message_bytes);
          }
          return absl::OkStatus();
        },
        FirstSlice());
    if (!status.ok()) return status;

    std::partial_sum(offsets.begin(), offsets.end(), offsets.begin());
    HitColumns columns(query_, rays_.size(), offsets.back(), summary_);
    columns.WriteOffsets(offsets);
    columns.WriteCounts(0, counts);
    Tracer::ForPieces(hits.size(), 1, [&](size_t piece, size_t) {
      columns.WriteHits(offsets[piece * piece_rays], hits[piece], mesh_);
    });
    return Answer(columns, offsets.back());
  }

 private:
  // Rays of which all hits are found are traced one by one, and each may take long; as may those that more of the tree
  // is built for.
  size_t FirstSlice() const {
    return HasAllHits(query_) || tree_.is_growing() ? kFirstSlice : RayBatchView::kMaxPieceRays;
  }

  QueryOptions OptionsFor(const SliceEnd& end) const {
    QueryOptions options = query_.options;
    options.stopped = end.asked();
    return options;
  }

  BatchAnswer Answer(HitColumns& columns, uint64_t hit_count) const {
    return {columns.Take(), summary_.accuracy, rays_.size(), hit_count};
  }

  // Most rows that the reply can hold: by its bytes, and by the offsets, which are uint32.
  uint64_t MaxHits() const {
    const uint64_t fixed = rays_.size() * BytesPerRay(query_) + kOverheadBytes;
    const uint64_t bytes = std::max(BytesPerHit(query_), uint64_t{1});
    return std::min<uint64_t>((limits_.max_message_bytes - fixed) / bytes, UINT32_MAX);
  }

  // Replaces the counts of rays that were stopped by max_hits_per_ray by the number of all triangles that they hit.
  void CountBeyondCap(std::span<const Ray> rays, const QueryOptions& options, std::span<uint32_t> counts) const {
    for (size_t i = 0; i < rays.size(); ++i) {
      if (counts[i] < options.max_hits_per_ray) continue;
      tree_.CountHits(rays.subspan(i, 1), options, counts.subspan(i, 1));
    }
  }

  const TriangleMesh& mesh_;
  const Tree& tree_;
  const BatchQuery& query_;
  const RayBatchView& rays_;
  const BatchLimits& limits_;
  const BatchControl& control_;
  const HitColumns::Summary summary_;
};

}  // namespace

bool IsSmall(const BatchQuery& query, size_t bytes) {
  return !HasAllHits(query) && HoldsRays(query, bytes, kSmallBatchRays);
}

bool IsShort(const BatchQuery& query, size_t bytes) {
  return !HasAllHits(query) && HoldsRays(query, bytes, kShortBatchRays);
}

uint64_t MaxAnswerBytes(const BatchQuery& query, size_t bytes, const BatchLimits& limits) {
  const uint64_t rays = std::min<uint64_t>(bytes / query.RayBytes(), limits.max_rays);
  const uint64_t fixed = std::min(rays * BytesPerRay(query) + kOverheadBytes, limits.max_message_bytes);
  if (query.kind != v1::QUERY_KIND_ALL_HITS) return fixed;
  const uint64_t row = std::max(BytesPerHit(query), uint64_t{1});
  const uint64_t hits = std::min(rays * query.options.max_hits_per_ray, (limits.max_message_bytes - fixed) / row);
  // Rows, and the hits of all pieces before, in vectors that may have grown to twice their size; offsets and counts.
  return fixed + hits * (row + 2 * sizeof(Hit)) + rays * 2 * sizeof(uint32_t);
}

absl::StatusOr<BatchAnswer> AnswerBatch(const TreeSnapshot& snapshot, const BatchQuery& query,
                                        const RayBatchBytes& batch, const BatchLimits& limits,
                                        const BatchControl& control) {
  absl::StatusOr<RayBatchView> rays = RayBatchView::Make(batch, query, *snapshot.mesh, limits.max_rays);
  if (!rays.ok()) return rays.status();
  if (rays->size() * BytesPerRay(query) + kOverheadBytes > limits.max_message_bytes) {
    return ReplyTooLarge(limits.max_message_bytes);
  }
  Answering answering(snapshot, query, *rays, limits, control);
  return query.kind == v1::QUERY_KIND_ALL_HITS ? answering.TraceAllHits() : answering.TraceRows();
}

}  // namespace deltaray
