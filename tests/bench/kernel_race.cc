#include "tests/bench/kernel_race.h"

#include <algorithm>
#include <iostream>
#include <span>

#include "absl/strings/str_format.h"
#include "tests/bench/kernel_run.h"
#include "tests/bench/measure.h"

namespace deltaray {
namespace {

// Float arithmetic loses some digits of t on triangles seen at a grazing angle, and all of them, which is to say the
// hit, on few rays that meet an edge.
constexpr float kTolerance = 1e-3f;
constexpr double kMaxDisagreementsPerMillion = 300;
constexpr size_t kWarmUpRays = 1 << 16;

// What is measured of a racer.
struct RaceResult {
  Samples mrays_s;
  size_t disagreements = 0;  // of the round with most
};

}  // namespace

absl::Status Race(const RaySet& set, const Tree& tree, const RaceOptions& options, std::vector<Racer>* racers) {
  const size_t rays = set.rays.size();
  if (rays == 0) return absl::OkStatus();
  std::vector<Hit> expected(rays), hits(rays);
  TraceAll(*MakeDeltarayKernel(tree, {}, set.question), set.rays, 1, options.chunk, expected);

  std::vector<RaceResult> results(racers->size());
  absl::Status status = Interleave(racers->size(), options.rounds, [&](size_t i) {
    const auto& [row, kernel] = (*racers)[i];
    // Each pass finds the caches as its own engine leaves them.
    const size_t warm_up = std::min(kWarmUpRays, rays);
    TraceAll(*kernel, std::span(set.rays).first(warm_up), row.threads, options.chunk, std::span(hits).first(warm_up));
    const double seconds = TraceAll(*kernel, set.rays, row.threads, options.chunk, hits);
    results[i].mrays_s.Add(MegaraysPerSecond(rays, row.threads, seconds));
    const bool exact = row.level == "exact";
    const size_t disagreements =
        exact ? CountDifferences(hits, expected) : CountDisagreements(hits, expected, kTolerance);
    results[i].disagreements = std::max(results[i].disagreements, disagreements);
    const double allowed = exact ? 0 : 1e-6 * kMaxDisagreementsPerMillion * static_cast<double>(rays);
    if (static_cast<double>(disagreements) <= allowed) return absl::OkStatus();
    return absl::InternalError(absl::StrFormat("%s %s: %d of %d answers of %s %s %s are not those of the exact level",
                                               row.scene, set.name, disagreements, rays, row.engine, row.mode,
                                               row.level));
  });
  if (!status.ok()) return status;

  for (size_t i = 0; i < racers->size(); ++i) {
    KernelRow& row = (*racers)[i].row;
    row.mrays_s = results[i].mrays_s.median();
    row.spread = results[i].mrays_s.spread();
    std::cerr << ToCsv(row) << "  (" << results[i].disagreements << " of " << rays << " rays disagree)\n";
  }
  return absl::OkStatus();
}

}  // namespace deltaray
