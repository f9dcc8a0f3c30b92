#include "tests/bench/build_bench.h"

#include <functional>
#include <iostream>
#include <memory>
#include <optional>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "tests/bench/embree.h"
#include "tests/bench/measure.h"

namespace deltaray {
namespace {

constexpr std::string_view kEmbree = "embree";

// What one build gave.
struct BuildResult {
  BuildCost cost;
  std::optional<TreeShape> shape;  // Embree tells nothing of it
};

// One line of the table.
struct Entry {
  std::string engine, preset;
  uint32_t threads = 1;
  std::function<absl::StatusOr<BuildResult>()> build;
  Samples seconds, cpu_seconds;
  BuildResult last;
};

std::string ToCsv(const Scene& scene, const Entry& entry) {
  const double triangles = static_cast<double>(scene.mesh->indices.size());
  std::string line = absl::StrFormat("%s,%s,%s,%d,%.4f,%.4f,%.1f,%.1f", scene.name, entry.engine, entry.preset,
                                     entry.threads, entry.seconds.median(), entry.cpu_seconds.median(),
                                     static_cast<double>(entry.last.cost.bytes) / triangles,
                                     static_cast<double>(entry.last.cost.peak_bytes) / triangles);
  const std::optional<TreeShape>& shape = entry.last.shape;
  absl::StrAppend(&line,
                  shape ? absl::StrFormat(",%.3f,%d,%d", shape->sah_cost, shape->references, shape->max_depth) : ",,,");
  return line;
}

// Adds the builds of one engine of ours.
absl::Status AddOurBuilds(const Scene& scene, const std::string& engine, const BuildBenchOptions& options,
                          std::vector<Entry>* entries) {
  const absl::StatusOr<Builder> builder = ParseEngine(engine);
  if (!builder.ok()) return builder.status();
  for (const std::string& preset_name : options.presets) {
    const absl::StatusOr<Preset> preset = ParsePreset(preset_name);
    if (!preset.ok()) return preset.status();
    for (const uint32_t threads : options.threads) {
      const auto build = [mesh = scene.mesh, config = MakeConfig(*builder, *preset),
                          threads]() -> absl::StatusOr<BuildResult> {
        const absl::StatusOr<FinishedBuild> build = BuildOnce(mesh, config, threads);
        if (!build.ok()) return build.status();
        return BuildResult{build->cost, build->statistics.shape};
      };
      entries->push_back({engine, preset_name, threads, build, {}, {}, {}});
    }
  }
  return absl::OkStatus();
}

void AddEmbreeBuilds(const Scene& scene, const BuildBenchOptions& options, std::vector<Entry>* entries) {
  for (const auto quality : {EmbreeScene::Quality::kMedium, EmbreeScene::Quality::kHigh}) {
    for (const uint32_t threads : options.threads) {
      const auto build = [mesh = scene.mesh, quality, threads]() -> absl::StatusOr<BuildResult> {
        const auto embree = EmbreeScene::Build(*mesh, {.quality = quality, .threads = threads});
        if (!embree.ok()) return embree.status();
        return BuildResult{(*embree)->build_cost(), std::nullopt};
      };
      const char* const name = quality == EmbreeScene::Quality::kHigh ? "high" : "medium";
      entries->push_back({std::string(kEmbree), name, threads, build, {}, {}, {}});
    }
  }
}

// How the hybrid's presets compare with Embree's qualities.
void PrintRatios(const Scene& scene, const std::vector<Entry>& entries) {
  const auto find = [&entries](std::string_view engine, std::string_view preset, uint32_t threads) -> const Entry* {
    for (const Entry& entry : entries) {
      if (entry.engine == engine && entry.preset == preset && entry.threads == threads) return &entry;
    }
    return nullptr;
  };
  for (const Entry& ours : entries) {
    if (ours.engine != EngineName(Builder::kHybrid)) continue;
    const std::string_view quality = ours.preset == PresetName(Preset::kFast) ? "medium" : "high";
    const Entry* const theirs = find(kEmbree, quality, ours.threads);
    if (theirs == nullptr) continue;
    std::cerr << absl::StrFormat(
        "%s, %d threads: %s / Embree's %s: time %.2f, processor time %.2f, bytes %.2f, peak bytes %.2f\n", scene.name,
        ours.threads, ours.preset, std::string(quality), ours.seconds.median() / theirs->seconds.median(),
        ours.cpu_seconds.median() / theirs->cpu_seconds.median(),
        static_cast<double>(ours.last.cost.bytes) / static_cast<double>(theirs->last.cost.bytes),
        static_cast<double>(ours.last.cost.peak_bytes) / static_cast<double>(theirs->last.cost.peak_bytes));
  }
}

}  // namespace

absl::Status RunBuildBench(const BuildBenchOptions& options) {
  const absl::StatusOr<std::vector<Scene>> scenes = LoadScenes(options.scenes);
  if (!scenes.ok()) return scenes.status();
  std::cerr << "peer: " << EmbreeVersion() << '\n';

  std::vector<std::string> lines = {
      "scene,engine,preset,threads,seconds,cpu_seconds,bytes_per_triangle,peak_bytes_per_triangle,sah_cost,references,"
      "max_depth"};
  for (const Scene& scene : *scenes) {
    std::vector<Entry> entries;
    for (const std::string& engine : options.engines) {
      if (engine != kEmbree) {
        if (absl::Status status = AddOurBuilds(scene, engine, options, &entries); !status.ok()) return status;
      } else if (HaveEmbree()) {
        AddEmbreeBuilds(scene, options, &entries);
      }
    }

    const absl::Status status = Interleave(entries.size(), options.rounds, [&](size_t i) {
      Entry& entry = entries[i];
      absl::StatusOr<BuildResult> result = entry.build();
      if (!result.ok()) return result.status();
      entry.seconds.Add(result->cost.seconds);
      entry.cpu_seconds.Add(result->cost.cpu_seconds);
      entry.last = *std::move(result);
      return absl::OkStatus();
    });
    if (!status.ok()) return status;
    for (const Entry& entry : entries) {
      lines.push_back(ToCsv(scene, entry));
      if (options.csv != "-") std::cerr << lines.back() << '\n';
    }
    PrintRatios(scene, entries);
  }
  return WriteLines(options.csv, lines);
}

}  // namespace deltaray
