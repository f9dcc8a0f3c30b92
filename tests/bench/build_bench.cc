#include "tests/bench/build_bench.h"

#include <iostream>

#include "absl/strings/str_format.h"
#include "tests/bench/measure.h"

namespace deltaray {
namespace {

// One line of the table.
struct Entry {
  const Scene* scene;
  Config config;
  uint32_t threads;
  Samples seconds, cpu_seconds;
  BuildStatistics last;
};

std::string ToCsv(const Entry& entry) {
  const TreeShape& shape = entry.last.shape;
  const double triangles = static_cast<double>(entry.scene->mesh->indices.size());
  return absl::StrFormat("%s,%s,%s,%d,%.4f,%.4f,%.1f,%.3f,%d,%d", entry.scene->name,
                         std::string(EngineName(entry.config.builder)), std::string(PresetName(entry.config.preset)),
                         entry.threads, entry.seconds.median(), entry.cpu_seconds.median(),
                         static_cast<double>(shape.node_bytes + shape.reference_bytes) / triangles, shape.sah_cost,
                         shape.references, shape.max_depth);
}

}  // namespace

absl::Status RunBuildBench(const BuildBenchOptions& options) {
  const absl::StatusOr<std::vector<Scene>> scenes = LoadScenes(options.scenes);
  if (!scenes.ok()) return scenes.status();

  std::vector<std::string> lines = {
      "scene,engine,preset,threads,seconds,cpu_seconds,bytes_per_triangle,sah_cost,references,max_depth"};
  for (const Scene& scene : *scenes) {
    std::vector<Entry> entries;
    for (const std::string& engine_name : options.engines) {
      const absl::StatusOr<Builder> engine = ParseEngine(engine_name);
      if (!engine.ok()) return engine.status();
      for (const std::string& preset_name : options.presets) {
        const absl::StatusOr<Preset> preset = ParsePreset(preset_name);
        if (!preset.ok()) return preset.status();
        for (const uint32_t threads : options.threads) {
          entries.push_back({&scene, MakeConfig(*engine, *preset), threads, {}, {}, {}});
        }
      }
    }

    const absl::Status status = Interleave(entries.size(), options.rounds, [&](size_t i) {
      Entry& entry = entries[i];
      const absl::StatusOr<FinishedBuild> build = BuildOnce(scene.mesh, entry.config, entry.threads);
      if (!build.ok()) return build.status();
      entry.seconds.Add(build->statistics.total_seconds);
      entry.cpu_seconds.Add(build->cpu_seconds());
      entry.last = build->statistics;
      return absl::OkStatus();
    });
    if (!status.ok()) return status;
    for (const Entry& entry : entries) {
      lines.push_back(ToCsv(entry));
      if (options.csv != "-") std::cerr << lines.back() << '\n';
    }
  }
  return WriteLines(options.csv, lines);
}

}  // namespace deltaray
