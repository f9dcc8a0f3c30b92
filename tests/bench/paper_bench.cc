#include "tests/bench/paper_bench.h"

#include <algorithm>
#include <iostream>
#include <utility>

#include "absl/strings/str_format.h"
#include "tests/bench/measure.h"
#include "tests/scenes/rays.h"

namespace deltaray {
namespace {

// One way to build the scene of an experiment.
struct Variant {
  std::string engine;
  Config config;
  Samples build_seconds, render_seconds;  // processor time of one thread
  FinishedBuild last;
};

// A figure or table on one scene. Others are compared with `variants[base]`.
struct Experiment {
  std::string name;
  const Scene* scene;
  size_t base;
  std::vector<Variant> variants;
};

constexpr const char* kHeader =
    "experiment,scene,engine,alpha,delta,build_seconds,build_low,build_high,render_seconds,render_low,render_high,"
    "build_relative,render_speedup,sah_cost,references_per_triangle,max_depth,spatial_splits,guard_splits,hits";

Variant MakeVariant(Builder builder, double alpha, uint32_t delta) {
  Variant variant{std::string(EngineName(builder)), MakeConfig(builder, Preset::kBalanced), {}, {}, {}};
  variant.config.alpha = alpha;
  variant.config.delta = delta;
  return variant;
}

// Figure 1: render time against α.
Experiment Figure1(const Scene& scene) {
  Experiment experiment{"figure_1", &scene, 6, {}};
  for (int tenths = 0; tenths <= 10; ++tenths) {
    experiment.variants.push_back(MakeVariant(Builder::kTang2015, tenths / 10.0, 32));
  }
  return experiment;
}

// Figure 2: build time and render speed against δ, relative to δ = 1.
Experiment Figure2(const Scene& scene) {
  Experiment experiment{"figure_2", &scene, 0, {}};
  for (uint32_t delta = 1; delta <= 256; delta *= 2) {
    experiment.variants.push_back(MakeVariant(Builder::kTang2015, 0.6, delta));
  }
  return experiment;
}

// Table 4: render time of the kd-tree, the BVH and the hybrid as printed, and of the hybrid as built here.
Experiment Table4(const Scene& scene) {
  Experiment experiment{"table_4", &scene, 1, {}};
  for (const Builder builder : {Builder::kKdTree, Builder::kBvh, Builder::kTang2015, Builder::kHybrid}) {
    experiment.variants.push_back(MakeVariant(builder, 0.6, 32));
  }
  return experiment;
}

absl::Status MeasureExperiment(const PaperBenchOptions& options, Experiment& experiment,
                               std::vector<std::string>* lines) {
  std::vector<Variant>& variants = experiment.variants;
  const std::shared_ptr<const TriangleMesh>& mesh = experiment.scene->mesh;
  absl::Status status = Interleave(variants.size(), options.build_rounds, [&](size_t i) {
    absl::StatusOr<FinishedBuild> build = BuildOnce(mesh, variants[i].config, 1);
    if (!build.ok()) return build.status();
    variants[i].build_seconds.Add(build->cost.cpu_seconds);
    variants[i].last = *std::move(build);
    return absl::OkStatus();
  });
  if (!status.ok()) return status;

  const std::vector<Ray> rays = CameraRays(MeshBounds(*mesh), options.width, options.height);
  std::vector<Hit> hits(rays.size()), first_hits;
  const auto render = [&](size_t i) {
    const double start = ThreadCpuSeconds();
    variants[i].last.snapshot->tree->ClosestHits(rays, {}, hits);
    variants[i].render_seconds.Add(ThreadCpuSeconds() - start);
    if (first_hits.empty()) first_hits = hits;
    return hits == first_hits ? absl::OkStatus()
                              : absl::InternalError(absl::StrFormat("%s gives another picture", variants[i].engine));
  };
  status = Interleave(variants.size(), options.render_rounds, render);
  if (!status.ok()) return status;

  const auto hit_count = std::count_if(hits.begin(), hits.end(), [](const Hit& hit) { return hit.IsHit(); });
  const Variant& base = variants[experiment.base];
  for (const Variant& v : variants) {
    const BuildStatistics& statistics = v.last.statistics;
    lines->push_back(absl::StrFormat(
        "%s,%s,%s,%.1f,%d,%.4f,%.4f,%.4f,%.4f,%.4f,%.4f,%.3f,%.3f,%.3f,%.3f,%d,%d,%d,%d", experiment.name,
        experiment.scene->name, v.engine, v.config.alpha, v.config.delta, v.build_seconds.median(),
        v.build_seconds.low(), v.build_seconds.high(), v.render_seconds.median(), v.render_seconds.low(),
        v.render_seconds.high(), v.build_seconds.median() / base.build_seconds.median(),
        base.render_seconds.median() / v.render_seconds.median(), statistics.shape.sah_cost,
        static_cast<double>(statistics.shape.references) / static_cast<double>(mesh->indices.size()),
        statistics.shape.max_depth, statistics.spatial_splits, statistics.object_splits + statistics.median_splits,
        hit_count));
    if (options.csv != "-") std::cerr << lines->back() << '\n';
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status RunPaperBench(const PaperBenchOptions& options) {
  const absl::StatusOr<std::vector<Scene>> scenes = LoadScenes(options.scenes);
  if (!scenes.ok()) return scenes.status();
  std::vector<Experiment> experiments = {Figure1(scenes->front()), Figure2(scenes->front())};
  for (const Scene& scene : *scenes) experiments.push_back(Table4(scene));

  std::vector<std::string> lines = {kHeader};
  for (Experiment& experiment : experiments) {
    if (absl::Status status = MeasureExperiment(options, experiment, &lines); !status.ok()) return status;
    experiment.variants.clear();
  }
  return WriteLines(options.csv, lines);
}

}  // namespace deltaray
