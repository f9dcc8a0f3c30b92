#include "tests/bench/kernel_bench.h"

#include <algorithm>
#include <array>
#include <iostream>
#include <memory>
#include <optional>
#include <span>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "tests/bench/embree.h"
#include "tests/bench/kernel.h"
#include "tests/bench/kernel_run.h"
#include "tests/bench/kernel_table.h"
#include "tests/bench/measure.h"
#include "tests/bench/ray_sets.h"

namespace deltaray {
namespace {

// Float arithmetic loses some digits of t on triangles seen at a grazing angle, and all of them, which is to say the
// hit, on few rays that meet an edge.
constexpr float kTolerance = 1e-3f;
constexpr double kMaxDisagreementsPerMillion = 300;
constexpr size_t kWarmUpRays = 1 << 16;

constexpr std::array<std::pair<std::string_view, Traversal>, 4> kModes = {{{"single", Traversal::kSingle},
                                                                           {"batch", Traversal::kBatch},
                                                                           {"packet", Traversal::kPacket},
                                                                           {"auto", Traversal::kAuto}}};

// One line of the CSV file while it is measured.
struct Entry {
  KernelRow row;
  std::shared_ptr<const Kernel> kernel;
  Samples mrays_s;
  size_t disagreements = 0;  // of the round with most
};

// A scene with all that is compared on it.
struct Contestants {
  const Scene* scene;
  FinishedBuild ours;
  std::unique_ptr<EmbreeScene> embree_fast, embree_robust;  // nullptr: built without Embree
};

absl::StatusOr<Contestants> BuildAll(const Scene& scene, const KernelBenchOptions& options) {
  const absl::StatusOr<Preset> preset = ParsePreset(options.preset);
  if (!preset.ok()) return preset.status();
  const absl::StatusOr<std::optional<SimdTarget>> simd_target = ParseSimdTarget(options.simd);
  if (!simd_target.ok()) return simd_target.status();
  absl::StatusOr<FinishedBuild> ours = BuildOnce(scene.mesh, MakeConfig(Builder::kHybrid, *preset), 0, *simd_target);
  if (!ours.ok()) return ours.status();
  Contestants contestants{&scene, *std::move(ours), nullptr, nullptr};
  if (!HaveEmbree()) return contestants;
  for (const bool robust : {false, true}) {
    auto embree = EmbreeScene::Build(*scene.mesh, {.robust = robust, .simd_target = *simd_target});
    if (!embree.ok()) return embree.status();
    (robust ? contestants.embree_robust : contestants.embree_fast) = *std::move(embree);
  }
  return contestants;
}

absl::StatusOr<AccuracyLevel> ParseLevel(std::string_view name) {
  if (name == "fast") return AccuracyLevel::kFast;
  if (name == "watertight") return AccuracyLevel::kWatertight;
  if (name == "exact") return AccuracyLevel::kExact;
  return absl::InvalidArgumentError(
      absl::StrCat("no level '", std::string(name), "'; there are fast, watertight, exact"));
}

absl::StatusOr<std::vector<Entry>> MakeEntries(const Contestants& contestants, const RaySet& set,
                                               const KernelBenchOptions& options) {
  std::vector<Entry> entries;
  const auto add = [&](std::string_view engine, std::string_view mode, std::string_view level,
                       std::unique_ptr<Kernel> kernel) {
    const std::shared_ptr<const Kernel> shared = std::move(kernel);
    for (const uint32_t threads : options.threads) {
      entries.push_back({.row = {.scene = contestants.scene->name,
                                 .rays = set.name,
                                 .engine = std::string(engine),
                                 .mode = std::string(mode),
                                 .level = std::string(level),
                                 .threads = threads},
                         .kernel = shared,
                         .mrays_s = {}});
    }
  };
  for (const std::string& name : options.levels) {
    const absl::StatusOr<AccuracyLevel> level = ParseLevel(name);
    if (!level.ok()) return level.status();
    for (const auto& [mode, traversal] : kModes) {
      if (traversal == Traversal::kPacket && !set.coherent) continue;
      QueryOptions query;
      query.accuracy = *level;
      query.traversal = traversal;
      add("deltaray", mode, name, MakeDeltarayKernel(*contestants.ours.snapshot->tree, query, set.question));
    }
  }
  for (const bool robust : {false, true}) {
    const EmbreeScene* const embree = (robust ? contestants.embree_robust : contestants.embree_fast).get();
    if (embree == nullptr) continue;
    for (const std::string& mode : embree->modes()) {
      // What is made for coherent rays is slower than the rest on others.
      if (!set.coherent && mode != "single" && mode != "1M") continue;
      add("embree", mode, robust ? "robust" : "fast", embree->MakeKernel(mode, set.question));
    }
  }
  return entries;
}

// Measures all entries on one set of rays and adds their rows.
absl::Status Measure(const Contestants& contestants, const RaySet& set, const KernelBenchOptions& options,
                     std::vector<KernelRow>* rows) {
  absl::StatusOr<std::vector<Entry>> entries = MakeEntries(contestants, set, options);
  if (!entries.ok()) return entries.status();
  if (set.rays.empty()) return absl::OkStatus();

  std::vector<float> expected(set.rays.size()), t(set.rays.size());
  TraceAll(*MakeDeltarayKernel(*contestants.ours.snapshot->tree, {}, set.question), set.rays, 1, options.chunk,
           expected);
  absl::Status status = Interleave(entries->size(), options.rounds, [&](size_t i) {
    Entry& entry = (*entries)[i];
    // Each pass finds the caches as its own engine leaves them.
    const size_t warm_up = std::min(kWarmUpRays, set.rays.size());
    TraceAll(*entry.kernel, std::span(set.rays).first(warm_up), entry.row.threads, options.chunk,
             std::span(t).first(warm_up));
    const double seconds = TraceAll(*entry.kernel, set.rays, entry.row.threads, options.chunk, t);
    entry.mrays_s.Add(MegaraysPerSecond(set.rays.size(), entry.row.threads, seconds));
    const bool exact = entry.row.level == "exact";
    entry.disagreements = std::max(entry.disagreements, CountDisagreements(t, expected, exact ? 0 : kTolerance));
    const double allowed = exact ? 0 : 1e-6 * kMaxDisagreementsPerMillion * static_cast<double>(t.size());
    if (static_cast<double>(entry.disagreements) <= allowed) return absl::OkStatus();
    return absl::InternalError(absl::StrFormat("%s %s: %d of %d answers of %s %s %s are not those of the exact level",
                                               entry.row.scene, set.name, entry.disagreements, t.size(),
                                               entry.row.engine, entry.row.mode, entry.row.level));
  });
  if (!status.ok()) return status;

  for (Entry& entry : *entries) {
    entry.row.mrays_s = entry.mrays_s.median();
    entry.row.spread = entry.mrays_s.spread();
    std::cerr << ToCsv(entry.row) << "  (" << entry.disagreements << " of " << t.size() << " rays disagree)\n";
    rows->push_back(entry.row);
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status RunKernelBench(const KernelBenchOptions& options) {
  const absl::StatusOr<std::vector<Scene>> scenes = LoadScenes(options.scenes);
  if (!scenes.ok()) return scenes.status();
  std::cerr << "peer: " << EmbreeVersion() << '\n';

  std::vector<KernelRow> rows;
  for (const Scene& scene : *scenes) {
    const absl::StatusOr<Contestants> contestants = BuildAll(scene, options);
    if (!contestants.ok()) return contestants.status();
    for (const std::string& name : options.rays) {
      const absl::StatusOr<RaySet> set = MakeRaySet(name, *scene.mesh, *contestants->ours.snapshot->tree, options.size);
      if (!set.ok()) return set.status();
      if (absl::Status status = Measure(*contestants, *set, options, &rows); !status.ok()) return status;
    }
  }

  std::vector<std::string> lines = {std::string(kKernelCsvHeader)};
  for (const KernelRow& row : rows) lines.push_back(ToCsv(row));
  if (absl::Status status = WriteLines(options.csv, lines); !status.ok()) return status;
  for (const std::string& line : KernelTable(std::move(rows)).Summary()) std::cerr << line << '\n';
  return absl::OkStatus();
}

}  // namespace deltaray
