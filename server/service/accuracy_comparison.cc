#include "server/service/accuracy_comparison.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cmath>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/build/mutex.h"
#include "server/build/thread_cpu.h"
#include "server/service/ray_batch.h"
#include "server/service/ray_pieces.h"

namespace deltaray {
namespace {

constexpr uint32_t kMaxRounds = 32;
constexpr std::array kLevels = {AccuracyLevel::kFast, AccuracyLevel::kWatertight, AccuracyLevel::kExact};

// The number of a float among all floats in ascending order; both zeros have one.
int64_t Rank(float value) {
  const auto bits = std::bit_cast<int32_t>(value);
  return bits < 0 ? int64_t{INT32_MIN} - bits : int64_t{bits};
}

// How the answers of one level differ from the exact ones.
struct Differences {
  uint64_t false_misses = 0;
  uint64_t false_hits = 0;
  uint64_t wrong_primitives = 0;
  double uv_error = 0;
  // Errors of t in ulp of the rays that are not wrong, but for those without an error.
  std::vector<uint32_t> t_errors;

  void Add(const Hit& hit, const Hit& exact) {
    if (!hit.IsHit() || !exact.IsHit()) {
      false_misses += exact.IsHit();
      false_hits += hit.IsHit();
    } else if (hit.primitive == exact.primitive) {
      if (hit.t != exact.t) t_errors.push_back(static_cast<uint32_t>(std::abs(Rank(hit.t) - Rank(exact.t))));
      uv_error = std::max({uv_error, std::abs(double{hit.u} - exact.u), std::abs(double{hit.v} - exact.v)});
    } else {
      wrong_primitives += hit.t != exact.t;
    }
  }

  void Add(bool any, bool exact) {
    false_misses += exact && !any;
    false_hits += any && !exact;
  }

  void Merge(const Differences& other) {
    false_misses += other.false_misses;
    false_hits += other.false_hits;
    wrong_primitives += other.wrong_primitives;
    uv_error = std::max(uv_error, other.uv_error);
    t_errors.insert(t_errors.end(), other.t_errors.begin(), other.t_errors.end());
  }
};

// One batch while it is compared.
class Comparison {
 public:
  Comparison(const TreeSnapshot& snapshot, const ComparisonQuery& comparison, const RayBatchView& rays,
             const BatchControl& control)
      : snapshot_(snapshot),
        any_hit_(comparison.query.kind == v1::QUERY_KIND_ANY_HIT),
        options_(comparison.query.options),
        rounds_(comparison.rounds),
        rays_(rays),
        control_(control) {}

  // Traces all rays at all levels and notes how the answers differ.
  absl::Status Compare() {
    const auto compare = [&](size_t, std::span<const Ray> rays, const SliceEnd& end) {
      std::array<Differences, kLevels.size()> differences;
      const uint64_t hits = any_hit_ ? CompareAny(rays, end, differences) : CompareClosest(rays, end, differences);
      if (end.came()) return absl::OkStatus();
      MutexLock lock(mutex_);
      hits_ += hits;
      for (size_t i = 0; i < kLevels.size(); ++i) differences_[i].Merge(differences[i]);
      return absl::OkStatus();
    };
    return ForRayPieces(rays_, PieceRays(rays_.size()), control_, compare);
  }

  // A round is all rays at one level after the other, not each piece at all levels: the second level would find what it
  // needs of the tree in the cache. Another level comes first in each.
  absl::Status MeasureTime() {
    for (uint32_t round = 0; round < rounds_; ++round) {
      for (size_t i = 0; i < kLevels.size(); ++i) {
        const size_t level = (round + i) % kLevels.size();
        std::atomic<int64_t> nanoseconds{0};
        const auto time = [&](size_t, std::span<const Ray> rays, const SliceEnd& end) {
          const int64_t taken = TimeOf(rays, kLevels[level], end);
          if (!end.came()) nanoseconds.fetch_add(taken, std::memory_order_relaxed);
          return absl::OkStatus();
        };
        const absl::Status status = ForRayPieces(rays_, PieceRays(rays_.size()), control_, time);
        if (!status.ok()) return status;
        times_[level].push_back(static_cast<double>(nanoseconds) / static_cast<double>(rays_.size()));
      }
    }
    return absl::OkStatus();
  }

  v1::CompareAccuracyResponse Take() {
    MutexLock lock(mutex_);
    v1::CompareAccuracyResponse response;
    response.set_ray_count(rays_.size());
    response.set_hit_count(hits_);
    const TreeShape shape = snapshot_.tree->Shape();
    response.set_node_bytes(shape.node_bytes);
    response.set_reference_bytes(shape.reference_bytes);
    response.set_mesh_bytes(snapshot_.mesh->Bytes());
    for (size_t i = 0; i < kLevels.size(); ++i) {
      Differences& differences = differences_[i];
      v1::AccuracyMeasurement* level = response.add_levels();
      level->set_accuracy(static_cast<v1::AccuracyLevel>(kLevels[i]));
      level->set_answered_accuracy(static_cast<v1::AccuracyLevel>(snapshot_.tree->answered_accuracy(kLevels[i])));
      level->set_false_misses(differences.false_misses);
      level->set_false_hits(differences.false_hits);
      level->set_wrong_primitives(differences.wrong_primitives);
      SetErrorsOfT(hits_ - differences.false_misses - differences.wrong_primitives, differences.t_errors, level);
      level->set_uv_error_max(differences.uv_error);
      std::vector<double>& times = times_[i];
      std::nth_element(times.begin(), times.begin() + times.size() / 2, times.end());
      level->set_nanoseconds_per_ray(times[times.size() / 2]);
    }
    return response;
  }

 private:
  QueryOptions OptionsOf(AccuracyLevel level, const SliceEnd& end) const {
    QueryOptions options = options_;
    options.accuracy = level;
    options.stopped = end.asked();
    return options;
  }

  // Both return the number of rays that hit; neither that nor the differences mean anything once the end has come.
  uint64_t CompareClosest(std::span<const Ray> rays, const SliceEnd& end, std::span<Differences> differences) const {
    PieceArray<Hit> exact_hits(rays.size());
    PieceArray<Hit> level_hits(rays.size());
    const std::span<Hit> exact = exact_hits;
    const std::span<Hit> hits = level_hits;
    snapshot_.tree->ClosestHits(rays, OptionsOf(AccuracyLevel::kExact, end), exact);
    for (size_t i = 0; i < kLevels.size(); ++i) {
      if (kLevels[i] == AccuracyLevel::kExact) continue;
      snapshot_.tree->ClosestHits(rays, OptionsOf(kLevels[i], end), hits);
      if (end.came()) return 0;
      for (size_t ray = 0; ray < rays.size(); ++ray) differences[i].Add(hits[ray], exact[ray]);
    }
    return std::count_if(exact.begin(), exact.end(), [](const Hit& hit) { return hit.IsHit(); });
  }

  uint64_t CompareAny(std::span<const Ray> rays, const SliceEnd& end, std::span<Differences> differences) const {
    PieceArray<uint8_t> exact_any(rays.size());
    PieceArray<uint8_t> level_any(rays.size());
    const std::span<uint8_t> exact = exact_any;
    const std::span<uint8_t> any = level_any;
    snapshot_.tree->AnyHits(rays, OptionsOf(AccuracyLevel::kExact, end), exact);
    for (size_t i = 0; i < kLevels.size(); ++i) {
      if (kLevels[i] == AccuracyLevel::kExact) continue;
      snapshot_.tree->AnyHits(rays, OptionsOf(kLevels[i], end), any);
      if (end.came()) return 0;
      for (size_t ray = 0; ray < rays.size(); ++ray) differences[i].Add(any[ray] != 0, exact[ray] != 0);
    }
    return std::count(exact.begin(), exact.end(), uint8_t{1});
  }

  int64_t TimeOf(std::span<const Ray> rays, AccuracyLevel level, const SliceEnd& end) const {
    PieceArray<Hit> hits(rays.size());
    PieceArray<uint8_t> any(rays.size());
    const int64_t start = ThreadCpuNanoseconds();
    if (any_hit_) {
      snapshot_.tree->AnyHits(rays, OptionsOf(level, end), any);
    } else {
      snapshot_.tree->ClosestHits(rays, OptionsOf(level, end), hits);
    }
    return ThreadCpuNanoseconds() - start;
  }

  // `errors`: of those of `rays` rays that have one.
  static void SetErrorsOfT(uint64_t rays, std::vector<uint32_t>& errors, v1::AccuracyMeasurement* level) {
    if (errors.empty()) return;
    level->set_t_error_ulp_max(*std::max_element(errors.begin(), errors.end()));
    // So many rays may exceed the 99.9 %.
    const size_t beyond = rays / 1000;
    if (beyond >= errors.size()) return;
    std::nth_element(errors.begin(), errors.begin() + beyond, errors.end(), std::greater<>());
    level->set_t_error_ulp_p999(errors[beyond]);
  }

  const TreeSnapshot& snapshot_;
  const bool any_hit_;
  const QueryOptions options_;
  const uint32_t rounds_;
  const RayBatchView& rays_;
  const BatchControl& control_;
  Mutex mutex_;
  uint64_t hits_ ABSL_GUARDED_BY(mutex_) = 0;
  std::array<Differences, kLevels.size()> differences_ ABSL_GUARDED_BY(mutex_);
  std::array<std::vector<double>, kLevels.size()> times_;  // nanoseconds a ray, of each round
};

}  // namespace

absl::StatusOr<ComparisonQuery> ReadComparison(const v1::CompareAccuracyRequest& request) {
  const v1::RayQuery& query = request.query();
  const std::pair<const char*, bool> unused[] = {{"columns", !query.columns().empty()},
                                                 {"accuracy", query.accuracy() != 0},
                                                 {"max_hits_per_ray", query.max_hits_per_ray() != 0},
                                                 {"wait", query.wait() != 0}};
  for (const auto& [field, is_set] : unused) {
    if (is_set) return absl::InvalidArgumentError(absl::StrCat("query.", field, ": must be unset in CompareAccuracy"));
  }
  if (request.rounds() > kMaxRounds) {
    return absl::InvalidArgumentError(
        absl::StrCat("rounds: ", request.rounds(), " is not in the range 1 to ", kMaxRounds, ", nor 0"));
  }
  absl::StatusOr<BatchQuery> batch_query = ReadQuery(query);
  if (!batch_query.ok()) return batch_query.status();
  if (batch_query->kind != v1::QUERY_KIND_CLOSEST_HIT && batch_query->kind != v1::QUERY_KIND_ANY_HIT) {
    return absl::InvalidArgumentError(
        absl::StrCat("query.kind: ", v1::QueryKind_Name(batch_query->kind),
                     " has one accuracy level; only CLOSEST_HIT and ANY_HIT have several"));
  }
  ComparisonQuery comparison;
  comparison.query = *batch_query;
  // Times of a tree that is being built would say nothing on the one that comes after it.
  comparison.query.wait_final = true;
  if (request.rounds() != 0) comparison.rounds = request.rounds();
  return comparison;
}

absl::StatusOr<v1::CompareAccuracyResponse> CompareAccuracy(const TreeSnapshot& snapshot,
                                                            const ComparisonQuery& comparison,
                                                            const RayBatchBytes& batch, uint32_t max_rays,
                                                            const BatchControl& control) {
  const absl::StatusOr<RayBatchView> rays = RayBatchView::Make(batch, comparison.query, *snapshot.mesh, max_rays);
  if (!rays.ok()) return rays.status();
  if (rays->size() == 0) return absl::InvalidArgumentError("rays.rays: there are none to compare by");
  Comparison run(snapshot, comparison, *rays, control);
  if (absl::Status status = run.Compare(); !status.ok()) return status;
  if (absl::Status status = run.MeasureTime(); !status.ok()) return status;
  return run.Take();
}

}  // namespace deltaray
