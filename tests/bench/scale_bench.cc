#include "tests/bench/scale_bench.h"

#include <algorithm>
#include <cmath>
#include <iostream>
#include <map>
#include <memory>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "tests/bench/embree.h"
#include "tests/bench/kernel_race.h"
#include "tests/bench/measure.h"
#include "tests/bench/ray_sets.h"
#include "tests/scenes/made.h"

namespace deltaray {
namespace {

absl::StatusOr<TriangleMesh> MakeScene(std::string_view name, uint32_t triangles) {
  if (name == "soup") return Soup(triangles);
  if (name == "terrain") {
    const auto side = static_cast<uint32_t>(std::lround(std::sqrt(0.5 * triangles)));
    return Terrain(side, side);
  }
  return absl::InvalidArgumentError(
      absl::StrCat("scene '", std::string(name), "' has one size; there are terrain, soup"));
}

// What the builds of one engine took, and the last one of them.
template <typename Structure>
struct Built {
  Structure structure{};
  Samples seconds, cpu_seconds;
  BuildCost last;

  void Add(Structure built, const BuildCost& cost) {
    structure = std::move(built);
    seconds.Add(cost.seconds);
    cpu_seconds.Add(cost.cpu_seconds);
    last = cost;
  }

  std::string ToCsv(uint64_t triangles) const {
    const double count = static_cast<double>(triangles);
    return absl::StrFormat("%.4f,%.4f,%.1f,%.1f", seconds.median(), cpu_seconds.median(),
                           static_cast<double>(last.bytes) / count, static_cast<double>(last.peak_bytes) / count);
  }
};

// By set of rays and level: how many times as fast as the better of Embree's calls we are, from size to size. Where it
// does not fall, we slow down no faster than Embree as triangles grow.
using Ratios = std::map<std::pair<std::string, std::string>, std::string>;

void AddRatios(const std::vector<Racer>& racers, uint64_t triangles, Ratios* ratios) {
  double embree = 0;
  for (const Racer& racer : racers) {
    if (racer.row.engine == "embree") embree = std::max(embree, racer.row.mrays_s);
  }
  if (embree == 0) return;
  for (const auto& [row, kernel] : racers) {
    if (row.engine == "embree") continue;
    absl::StrAppendFormat(&(*ratios)[{row.rays, row.level}], "  %d: %.2f", triangles, row.mrays_s / embree);
  }
}

// One size of one scene.
absl::Status MeasureMesh(std::string_view name, const std::shared_ptr<const TriangleMesh>& mesh,
                         const ScaleBenchOptions& options, Ratios* ratios, std::vector<std::string>* lines) {
  const absl::StatusOr<Preset> preset = ParsePreset(options.preset);
  if (!preset.ok()) return preset.status();
  Built<FinishedBuild> ours;
  Built<std::unique_ptr<EmbreeScene>> embree;
  absl::Status status = Interleave(HaveEmbree() ? 2 : 1, options.build_rounds, [&](size_t i) {
    if (i == 0) {
      absl::StatusOr<FinishedBuild> build = BuildOnce(mesh, MakeConfig(Builder::kHybrid, *preset), options.threads);
      if (!build.ok()) return build.status();
      const BuildCost cost = build->cost;
      ours.Add(*std::move(build), cost);
    } else {
      absl::StatusOr<std::unique_ptr<EmbreeScene>> build = EmbreeScene::Build(*mesh, {.threads = options.threads});
      if (!build.ok()) return build.status();
      const BuildCost cost = (*build)->build_cost();
      embree.Add(*std::move(build), cost);
    }
    return absl::OkStatus();
  });
  if (!status.ok()) return status;

  const uint64_t triangles = mesh->indices.size();
  for (const std::string& set_name : options.rays) {
    const Tree& tree = *ours.structure.snapshot->tree;
    const absl::StatusOr<RaySet> set = MakeRaySet(set_name, *mesh, tree, options.size);
    if (!set.ok()) return set.status();
    const std::string scene = absl::StrCat(std::string(name), " ", triangles);
    std::vector<Racer> racers;
    for (const std::string& level_name : options.levels) {
      const absl::StatusOr<AccuracyLevel> level = ParseLevel(level_name);
      if (!level.ok()) return level.status();
      QueryOptions query;
      query.accuracy = *level;
      query.traversal = Traversal::kBatch;
      racers.push_back({{.scene = scene, .rays = set_name, .engine = "deltaray", .mode = "batch", .level = level_name},
                        MakeDeltarayKernel(tree, query, set->question)});
    }
    if (embree.structure != nullptr) {
      for (const char* const mode : {"single", "1M"}) {
        racers.push_back({{.scene = scene, .rays = set_name, .engine = "embree", .mode = mode, .level = "fast"},
                          embree.structure->MakeKernel(mode, set->question)});
      }
    }
    status = Race(*set, tree, {.rounds = options.rounds}, &racers);
    if (!status.ok()) return status;
    AddRatios(racers, triangles, ratios);
    for (const Racer& racer : racers) {
      const KernelRow& row = racer.row;
      const bool is_ours = row.engine == "deltaray";
      lines->push_back(absl::StrFormat("%s,%d,%s,%s,%s,%s,%.3f,%.3f,%s", std::string(name), triangles, row.rays,
                                       row.engine, row.mode, row.level, row.mrays_s, row.spread,
                                       is_ours ? ours.ToCsv(triangles) : embree.ToCsv(triangles)));
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status RunScaleBench(const ScaleBenchOptions& options) {
  std::cerr << "peer: " << EmbreeVersion() << '\n';
  std::vector<std::string> lines = {
      "scene,triangles,rays,engine,mode,level,mrays_s,spread,build_seconds,build_cpu_seconds,bytes_per_triangle,"
      "peak_bytes_per_triangle"};
  for (const std::string& name : options.scenes) {
    Ratios ratios;
    for (const uint32_t triangles : options.triangles) {
      absl::StatusOr<TriangleMesh> made = MakeScene(name, triangles);
      if (!made.ok()) return made.status();
      const auto mesh = std::make_shared<const TriangleMesh>(*std::move(made));
      if (absl::Status status = MeasureMesh(name, mesh, options, &ratios, &lines); !status.ok()) return status;
      // Large sizes take long: what there is so far is kept.
      if (absl::Status status = WriteLines(options.csv, lines); !status.ok()) return status;
      if (options.csv == "-") lines.clear();
    }
    for (const auto& [set_and_level, text] : ratios) {
      std::cerr << name << ' ' << set_and_level.first << ", " << set_and_level.second << " / Embree HIGH:" << text
                << '\n';
    }
  }
  return absl::OkStatus();
}

}  // namespace deltaray
