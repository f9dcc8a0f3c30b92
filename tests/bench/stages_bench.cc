#include "tests/bench/stages_bench.h"

#include <iostream>
#include <latch>
#include <memory>
#include <utility>

#include "absl/strings/str_format.h"
#include "tests/bench/kernel.h"
#include "tests/bench/kernel_race.h"
#include "tests/bench/measure.h"
#include "tests/bench/ray_sets.h"

namespace deltaray {
namespace {

using Snapshot = std::shared_ptr<const TreeSnapshot>;

// A tree as queries find it.
struct Stage {
  std::string name;
  Snapshot snapshot;
};

absl::StatusOr<Snapshot> ProvisionalTree(const Scene& scene, const Config& config) {
  // No δ-leaf is built before the tree without them was seen.
  std::latch seen(1);
  Build::Options options;
  options.config = config;
  options.on_delta_leaf = [&seen] { seen.wait(); };
  const std::shared_ptr<Build> build = Build::Start(scene.mesh, std::move(options));
  absl::Status status = build->WaitProvisional();
  Snapshot snapshot = build->snapshot();
  seen.count_down();
  if (status.ok()) status = build->WaitDone();
  if (!status.ok()) return status;
  if (snapshot->final) return absl::InternalError(scene.name + ": its build has no provisional tree");
  return snapshot;
}

absl::StatusOr<std::vector<Stage>> MakeStages(const Scene& scene) {
  const Config config = MakeConfig(Builder::kHybrid, Preset::kBalanced);
  absl::StatusOr<Snapshot> provisional = ProvisionalTree(scene, config);
  if (!provisional.ok()) return provisional.status();
  Config lazy_config = config;
  lazy_config.lazy = true;
  absl::StatusOr<FinishedBuild> lazy = BuildOnce(scene.mesh, lazy_config, 0);
  if (!lazy.ok()) return lazy.status();
  absl::StatusOr<FinishedBuild> whole = BuildOnce(scene.mesh, config, 0);
  if (!whole.ok()) return whole.status();
  return std::vector<Stage>{
      {"provisional", *std::move(provisional)}, {"lazy", lazy->snapshot}, {"final", whole->snapshot}};
}

std::string Line(const Scene& scene, const std::string& quantity, const std::string& tree, double value,
                 double spread) {
  return absl::StrFormat("%s,%s,%s,%.4f,%.3f", scene.name, quantity, tree, value, spread);
}

// Millions of rays per second on each of the trees.
absl::Status MeasureRays(const Scene& scene, const StagesBenchOptions& options, std::vector<std::string>* lines) {
  absl::StatusOr<std::vector<Stage>> stages = MakeStages(scene);
  if (!stages.ok()) return stages.status();
  const Tree& final_tree = *stages->back().snapshot->tree;
  for (const std::string& name : options.rays) {
    const absl::StatusOr<RaySet> set = MakeRaySet(name, *scene.mesh, final_tree, options.size);
    if (!set.ok()) return set.status();
    std::vector<Racer> racers;
    for (const Stage& stage : *stages) {
      Racer& racer = racers.emplace_back();
      racer.row.scene = scene.name;
      racer.row.rays = name;
      racer.row.engine = "deltaray";
      racer.row.mode = stage.name;
      racer.row.level = "exact";
      racer.kernel = MakeDeltarayKernel(*stage.snapshot->tree, {}, set->question);
    }
    // The lazy tree builds what these rays reach, and is laid out with it.
    if (absl::Status status = Race(*set, final_tree, {.rounds = 2}, &racers); !status.ok()) return status;
    if (absl::Status status = Race(*set, final_tree, {.rounds = options.rounds}, &racers); !status.ok()) return status;
    for (const auto& [row, kernel] : racers) lines->push_back(Line(scene, name, row.mode, row.mrays_s, row.spread));
  }
  return absl::OkStatus();
}

// The part of a build after which rays are answered, on one thread.
absl::Status MeasureWait(const Scene& scene, uint32_t rounds, std::vector<std::string>* lines) {
  Samples parts;
  for (uint32_t round = 0; round < rounds; ++round) {
    const auto build = BuildOnce(scene.mesh, MakeConfig(Builder::kHybrid, Preset::kBalanced), /*threads=*/1);
    if (!build.ok()) return build.status();
    parts.Add(build->statistics.provisional_seconds / build->statistics.total_seconds);
  }
  lines->push_back(Line(scene, "answered_after", "provisional", parts.median(), parts.spread()));
  return absl::OkStatus();
}

}  // namespace

absl::Status RunStagesBench(const StagesBenchOptions& options) {
  const absl::StatusOr<std::vector<Scene>> scenes = LoadScenes(options.scenes);
  if (!scenes.ok()) return scenes.status();
  std::vector<std::string> lines = {"scene,quantity,tree,value,spread"};
  for (const Scene& scene : *scenes) {
    if (absl::Status status = MeasureRays(scene, options, &lines); !status.ok()) return status;
    if (absl::Status status = MeasureWait(scene, options.rounds, &lines); !status.ok()) return status;
  }
  return WriteLines(options.csv, lines);
}

}  // namespace deltaray
