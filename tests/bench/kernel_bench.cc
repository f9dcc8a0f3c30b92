#include "tests/bench/kernel_bench.h"

#include <array>
#include <iostream>
#include <memory>
#include <optional>
#include <utility>

#include "tests/bench/embree.h"
#include "tests/bench/kernel.h"
#include "tests/bench/kernel_race.h"
#include "tests/bench/kernel_table.h"
#include "tests/bench/measure.h"
#include "tests/bench/ray_sets.h"

namespace deltaray {
namespace {

constexpr std::array<std::pair<std::string_view, Traversal>, 5> kModes = {{{"single", Traversal::kSingle},
                                                                           {"batch", Traversal::kBatch},
                                                                           {"packet", Traversal::kPacket},
                                                                           {"stream", Traversal::kStream},
                                                                           {"auto", Traversal::kAuto}}};

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

absl::StatusOr<std::vector<Racer>> MakeRacers(const Contestants& contestants, const RaySet& set,
                                              const KernelBenchOptions& options) {
  std::vector<Racer> racers;
  const auto add = [&](std::string_view engine, std::string_view mode, std::string_view level,
                       std::unique_ptr<Kernel> kernel) {
    const std::shared_ptr<const Kernel> shared = std::move(kernel);
    for (const uint32_t threads : options.threads) {
      racers.push_back({.row = {.scene = contestants.scene->name,
                                .rays = set.name,
                                .engine = std::string(engine),
                                .mode = std::string(mode),
                                .level = std::string(level),
                                .threads = threads},
                        .kernel = shared});
    }
  };
  for (const std::string& name : options.levels) {
    const absl::StatusOr<AccuracyLevel> level = ParseLevel(name);
    if (!level.ok()) return level.status();
    for (const auto& [mode, traversal] : kModes) {
      if (traversal == Traversal::kPacket && !set.coherent) continue;
      if (traversal == Traversal::kStream && set.question != Question::kAnyHit) continue;
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
  return racers;
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
      absl::StatusOr<std::vector<Racer>> racers = MakeRacers(*contestants, *set, options);
      if (!racers.ok()) return racers.status();
      absl::Status status = Race(*set, *contestants->ours.snapshot->tree, {options.chunk, options.rounds}, &*racers);
      if (!status.ok()) return status;
      for (Racer& racer : *racers) rows.push_back(std::move(racer.row));
    }
  }

  std::vector<std::string> lines = {std::string(kKernelCsvHeader)};
  for (const KernelRow& row : rows) lines.push_back(ToCsv(row));
  if (absl::Status status = WriteLines(options.csv, lines); !status.ok()) return status;
  for (const std::string& line : KernelTable(std::move(rows)).Summary()) std::cerr << line << '\n';
  return absl::OkStatus();
}

}  // namespace deltaray
