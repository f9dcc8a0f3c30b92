#include "tests/bench/accuracy_bench.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <iostream>
#include <limits>
#include <memory>
#include <optional>
#include <utility>

#include "absl/strings/str_format.h"
#include "server/geometry/exact_triangle.h"
#include "tests/bench/embree.h"
#include "tests/bench/kernel.h"
#include "tests/bench/kernel_run.h"
#include "tests/bench/measure.h"
#include "tests/oracle/judge.h"
#include "tests/oracle/oracle.h"
#include "tests/stability/families.h"

namespace deltaray {
namespace {

// What is judged: one structure asked in one way.
struct Contestant {
  std::string_view engine, structure, level;
  std::shared_ptr<const void> owner;  // of what the kernel asks
  std::unique_ptr<Kernel> kernel;
  Samples seconds = {};  // of one pass
  std::vector<Hit> hits = {};
  uint64_t exact_decisions = 0;
};

absl::Status AddOurs(const StabilityFamily& family, Builder builder, std::vector<Contestant>* contestants) {
  absl::StatusOr<FinishedBuild> build = BuildOnce(family.mesh, MakeConfig(builder, Preset::kBalanced), /*threads=*/0);
  if (!build.ok()) return build.status();
  const std::shared_ptr<const TreeSnapshot> snapshot = build->snapshot;
  for (const auto& [name, level] :
       {std::pair("fast", AccuracyLevel::kFast), std::pair("watertight", AccuracyLevel::kWatertight),
        std::pair("exact", AccuracyLevel::kExact)}) {
    QueryOptions query;
    query.accuracy = level;
    // Structures that know one level only.
    if (snapshot->tree->answered_accuracy(level) != level) continue;
    contestants->push_back({.engine = "deltaray",
                            .structure = EngineName(builder),
                            .level = name,
                            .owner = snapshot,
                            .kernel = MakeDeltarayKernel(*snapshot->tree, query, Question::kClosestHit)});
  }
  return absl::OkStatus();
}

// Embree takes no mesh of nothing, and its assertions end the program at numbers that it calls too large and at
// intervals that begin before the origin.
bool EmbreeTakes(const StabilityFamily& family) {
  constexpr float kLarge = 1.844e18f;
  const auto takes = [](Vec3f a) { return std::max({std::abs(a.x), std::abs(a.y), std::abs(a.z)}) < kLarge; };
  return !family.mesh->indices.empty() && std::ranges::all_of(family.rays, [&](const Ray& ray) {
    return takes(ray.origin) && takes(ray.direction) && ray.t_min >= 0;
  });
}

absl::Status AddEmbree(const StabilityFamily& family, std::vector<Contestant>* contestants) {
  if (!HaveEmbree() || !EmbreeTakes(family)) return absl::OkStatus();
  for (const bool robust : {false, true}) {
    absl::StatusOr<std::unique_ptr<EmbreeScene>> built = EmbreeScene::Build(*family.mesh, {.robust = robust});
    if (!built.ok()) return built.status();
    const std::shared_ptr<const EmbreeScene> scene = *std::move(built);
    contestants->push_back({.engine = "embree",
                            .structure = "high",
                            .level = robust ? "robust" : "fast",
                            .owner = scene,
                            .kernel = scene->MakeKernel("1M", Question::kClosestHit)});
  }
  return absl::OkStatus();
}

// What is wrong with the answers of one contestant.
struct Errors {
  std::array<size_t, 5> verdicts{};
  size_t inexact = 0;                      // answers that are not right in all that they say
  uint32_t t_ulp_p999 = 0, t_ulp_max = 0;  // of hits at the exact t
  double uv_error_max = 0;                 // of hits of the right primitive

  size_t Count(Verdict verdict) const { return verdicts[static_cast<size_t>(verdict)]; }
};

Errors FindErrors(const Oracle& oracle, std::span<const Ray> rays, std::span<const std::optional<OracleHit>> truth,
                  std::span<const Hit> hits) {
  Errors errors;
  std::vector<uint32_t> t_ulps;
  for (size_t i = 0; i < rays.size(); ++i) {
    const Verdict verdict = Judge(oracle, rays[i], truth[i], hits[i].primitive);
    ++errors.verdicts[static_cast<size_t>(verdict)];
    errors.inexact += !IsRight(truth[i], hits[i]);
    if (!hits[i].IsHit() || (verdict != Verdict::kRight && verdict != Verdict::kWrongPrimitive)) continue;
    t_ulps.push_back(StepsApart(hits[i].t, truth[i]->t));
    if (verdict != Verdict::kRight) continue;
    for (const double error : {hits[i].u - truth[i]->u, hits[i].v - truth[i]->v}) {
      // max() would pass over what is no number.
      const double size = std::isnan(error) ? std::numeric_limits<double>::infinity() : std::abs(error);
      errors.uv_error_max = std::max(errors.uv_error_max, size);
    }
  }
  if (t_ulps.empty()) return errors;
  std::ranges::sort(t_ulps);
  errors.t_ulp_max = t_ulps.back();
  errors.t_ulp_p999 = t_ulps[static_cast<size_t>(0.999 * static_cast<double>(t_ulps.size() - 1))];
  return errors;
}

absl::Status MeasureFamily(const StabilityFamily& family, const AccuracyBenchOptions& options,
                           std::vector<std::string>* lines) {
  std::vector<Contestant> contestants;
  for (const std::string& name : options.structures) {
    if (name == "embree") {
      if (absl::Status status = AddEmbree(family, &contestants); !status.ok()) return status;
      continue;
    }
    const absl::StatusOr<Builder> builder = ParseEngine(name);
    if (!builder.ok()) return builder.status();
    if (absl::Status status = AddOurs(family, *builder, &contestants); !status.ok()) return status;
  }
  absl::Status status = Interleave(contestants.size(), options.rounds, [&](size_t i) {
    Contestant& contestant = contestants[i];
    contestant.hits.resize(family.rays.size());
    // A pass may take a millisecond, and the contestant before may have left this tree or another one in the caches.
    TraceAll(*contestant.kernel, family.rays, 1, kChunk, contestant.hits);
    const uint64_t decisions = ExactDecisions();
    contestant.seconds.Add(TraceAll(*contestant.kernel, family.rays, 1, kChunk, contestant.hits));
    contestant.exact_decisions = ExactDecisions() - decisions;
    return absl::OkStatus();
  });
  if (!status.ok()) return status;

  const Oracle oracle(family.mesh->triangles());
  const std::vector<std::optional<OracleHit>> truth = oracle.ClosestHits(family.rays);
  for (const Contestant& contestant : contestants) {
    const Errors errors = FindErrors(oracle, family.rays, truth, contestant.hits);
    lines->push_back(absl::StrFormat(
        "%s,%s,%s,%s,%d,%d,%d,%d,%d,%d,%d,%.3g,%d,%.1f", family.name, contestant.engine, contestant.structure,
        contestant.level, family.rays.size(), errors.Count(Verdict::kFalseMiss), errors.Count(Verdict::kFalseHit),
        errors.Count(Verdict::kWrongSurface), errors.Count(Verdict::kWrongPrimitive), errors.t_ulp_p999,
        errors.t_ulp_max, errors.uv_error_max, contestant.exact_decisions,
        1e9 * contestant.seconds.median() / static_cast<double>(family.rays.size())));
    std::cerr << lines->back() << '\n';
    if (contestant.level == "exact" && errors.inexact != 0) {
      return absl::InternalError(absl::StrFormat("%s: %d answers of %s at the exact level are wrong", family.name,
                                                 errors.inexact, contestant.structure));
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status RunAccuracyBench(const AccuracyBenchOptions& options) {
  std::cerr << "peer: " << EmbreeVersion() << '\n';
  std::vector<std::string> lines = {
      "family,engine,structure,level,rays,false_miss,false_hit,wrong_surface,wrong_primitive,t_ulp_p999,t_ulp_max,"
      "uv_error_max,exact_decisions,ns_per_ray"};
  for (const std::string& name : options.families.empty() ? StabilityFamilyNames() : options.families) {
    const absl::StatusOr<StabilityFamily> family = MakeStabilityFamily(name, options.rays);
    if (!family.ok()) return family.status();
    if (absl::Status status = MeasureFamily(*family, options, &lines); !status.ok()) return status;
    // All families take long: what there is so far is kept.
    if (absl::Status status = WriteLines(options.csv, lines); !status.ok()) return status;
    if (options.csv == "-") lines.clear();
  }
  return absl::OkStatus();
}

}  // namespace deltaray
