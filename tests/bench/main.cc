// deltaray_bench: measures building and tracing; see README.md.

#include <CLI/CLI.hpp>
#include <iostream>

#include "tests/bench/accuracy_bench.h"
#include "tests/bench/build_bench.h"
#include "tests/bench/kernel_bench.h"
#include "tests/bench/paper_bench.h"
#include "tests/bench/scale_bench.h"
#include "tests/bench/service_bench.h"
#include "tests/bench/stages_bench.h"

int main(int argc, char** argv) {
  CLI::App app("Measures how deltaray builds and traces. tests/bench/README.md explains the columns.");
  app.require_subcommand(1);
  app.option_defaults()->always_capture_default()->delimiter(',');

  deltaray::BuildBenchOptions build_options;
  build_options.scenes = {"bunny", "dragon", "elephant", "city", "soup"};
  build_options.engines = {"hybrid", "kd_tree", "bvh", "sbvh", "tang2015", "embree"};
  build_options.presets = {"balanced"};
  build_options.threads = {1, 2};
  build_options.csv = "-";
  CLI::App* const build = app.add_subcommand("build", "Time, size and SAH cost of all builders, beside Embree's.");
  build->add_option("--scenes", build_options.scenes, "Names of scenes");
  build->add_option("--engines", build_options.engines, "hybrid, kd_tree, bvh, sbvh, tang2015, embree");
  build->add_option("--presets", build_options.presets, "fast, balanced, best, auto");
  build->add_option("--threads", build_options.threads, "Threads to build with")->check(CLI::Range(1, 1024));
  build->add_option("--rounds", build_options.rounds, "Builds to take the median of")->check(CLI::Range(1, 1000));
  build->add_option("--csv", build_options.csv, "File to write; - is standard output");

  deltaray::PaperBenchOptions paper_options;
  paper_options.scenes = {"bunny", "dragon"};
  paper_options.csv = "-";
  CLI::App* const paper = app.add_subcommand("paper", "Figures 1 and 2 and table 4 of [Tang 2015].");
  paper->add_option("--scenes", paper_options.scenes, "Scenes of table 4; the figures use the first one");
  paper->add_option("--width", paper_options.width, "Of the picture, in pixels")->check(CLI::Range(1, 8192));
  paper->add_option("--height", paper_options.height, "Of the picture, in pixels")->check(CLI::Range(1, 8192));
  paper->add_option("--build-rounds", paper_options.build_rounds, "Builds to take the median of")
      ->check(CLI::Range(1, 1000));
  paper->add_option("--render-rounds", paper_options.render_rounds, "Pictures to take the median of")
      ->check(CLI::Range(1, 1000));
  paper->add_option("--csv", paper_options.csv, "File to write; - is standard output");

  deltaray::KernelBenchOptions kernel_options;
  kernel_options.scenes = {"bunny", "dragon", "elephant", "city", "soup"};
  kernel_options.rays = {"camera", "bounce", "chords", "shadow"};
  kernel_options.levels = {"fast", "watertight", "exact"};
  kernel_options.threads = {1, 2};
  kernel_options.preset = "balanced";
  kernel_options.simd = "best";
  kernel_options.csv = "-";
  CLI::App* const kernel = app.add_subcommand("kernel", "Rays per second of every kernel, beside Embree's.");
  kernel->add_option("--scenes", kernel_options.scenes, "Names of scenes");
  kernel->add_option("--rays", kernel_options.rays, "camera, bounce, chords, shadow");
  kernel->add_option("--levels", kernel_options.levels, "fast, watertight, exact");
  kernel->add_option("--threads", kernel_options.threads, "Threads to trace with")->check(CLI::Range(1, 1024));
  kernel->add_option("--preset", kernel_options.preset, "Of our tree: fast, balanced, best, auto");
  kernel->add_option("--simd", kernel_options.simd, "best, sse4, avx2, avx512; Embree gets the same");
  kernel->add_option("--size", kernel_options.size, "Camera rays: size x size")->check(CLI::Range(1, 8192));
  kernel->add_option("--chunk", kernel_options.chunk, "Rays to give a kernel at once")->check(CLI::Range(1, 1 << 20));
  kernel->add_option("--rounds", kernel_options.rounds, "Passes to take the median of")->check(CLI::Range(1, 1000));
  kernel->add_option("--csv", kernel_options.csv, "File to write; - is standard output");

  deltaray::ServiceBenchOptions service_options;
  service_options.scenes = {"bunny"};
  service_options.rays = {"camera", "bounce", "miss"};
  service_options.streams = {1, 2, 4, 8, 16};
  service_options.batches = {64, 256, 1024, 4096, 16384, 65536};
  service_options.upload_scene = "dragon";
  service_options.csv = "-";
  CLI::App* const service = app.add_subcommand("service", "What gRPC on loopback costs beyond tracing.");
  service->add_option("--scenes", service_options.scenes, "Names of scenes");
  service->add_option("--rays", service_options.rays, "camera, bounce, chords, miss");
  service->add_option("--streams", service_options.streams, "Streams at once")->check(CLI::Range(1, 256));
  service->add_option("--batches", service_options.batches, "Rays of a batch")->check(CLI::Range(1, 1 << 20));
  service->add_option("--upload-scene", service_options.upload_scene, "Uploaded to see how soon it is answered from");
  service
      ->add_option("--certificates", service_options.certificates,
                   "Directory that tests/certificates.sh has filled: measures TLS too")
      ->check(CLI::ExistingDirectory);
  service->add_option("--size", service_options.size, "Camera rays: size x size")->check(CLI::Range(1, 8192));
  service->add_option("--calls", service_options.calls, "Calls to take latencies of")->check(CLI::Range(1, 1 << 20));
  service->add_option("--rounds", service_options.rounds, "Passes to take the median of")->check(CLI::Range(1, 1000));
  service->add_option("--server", service_options.server, "deltarayd; empty: the one beside this program");
  service->add_option("--csv", service_options.csv, "File to write; - is standard output");

  deltaray::StagesBenchOptions stages_options;
  stages_options.scenes = {"bunny", "dragon", "city"};
  stages_options.rays = {"camera", "bounce", "chords", "shadow"};
  stages_options.csv = "-";
  CLI::App* const stages = app.add_subcommand("stages", "Tracing on the provisional, the lazy and the final tree.");
  stages->add_option("--scenes", stages_options.scenes, "Names of scenes");
  stages->add_option("--rays", stages_options.rays, "camera, bounce, chords, shadow");
  stages->add_option("--size", stages_options.size, "Camera rays: size x size")->check(CLI::Range(1, 8192));
  stages->add_option("--rounds", stages_options.rounds, "Passes, and builds, to take the median of")
      ->check(CLI::Range(1, 1000));
  stages->add_option("--csv", stages_options.csv, "File to write; - is standard output");

  deltaray::ScaleBenchOptions scale_options;
  scale_options.scenes = {"terrain", "soup"};
  scale_options.triangles = {10'000, 30'000, 100'000, 300'000, 1'000'000, 3'000'000, 10'000'000};
  scale_options.rays = {"bounce", "chords"};
  scale_options.levels = {"watertight", "exact"};
  scale_options.preset = "balanced";
  scale_options.csv = "-";
  CLI::App* const scale = app.add_subcommand("scale", "Building and tracing against the number of triangles.");
  scale->add_option("--scenes", scale_options.scenes, "terrain, soup");
  scale->add_option("--triangles", scale_options.triangles, "Sizes")->check(CLI::Range(2, 100'000'000));
  scale->add_option("--rays", scale_options.rays, "camera, bounce, chords, shadow");
  scale->add_option("--levels", scale_options.levels, "fast, watertight, exact");
  scale->add_option("--preset", scale_options.preset, "Of our tree: fast, balanced, best, auto");
  scale->add_option("--threads", scale_options.threads, "Threads to build with; 0: all cores");
  scale->add_option("--size", scale_options.size, "Camera rays: size x size")->check(CLI::Range(1, 8192));
  scale->add_option("--build-rounds", scale_options.build_rounds, "Builds to take the median of")
      ->check(CLI::Range(1, 1000));
  scale->add_option("--rounds", scale_options.rounds, "Passes to take the median of")->check(CLI::Range(1, 1000));
  scale->add_option("--csv", scale_options.csv, "File to write; - is standard output");

  deltaray::AccuracyBenchOptions accuracy_options;
  accuracy_options.structures = {"hybrid", "kd_tree", "bvh", "sbvh", "tang2015", "embree"};
  accuracy_options.csv = "-";
  CLI::App* const accuracy =
      app.add_subcommand("accuracy", "Speed against accuracy where methods fail, beside Embree's.");
  accuracy->add_option("--families", accuracy_options.families, "Of tests/stability/README.md; all by default");
  accuracy->add_option("--structures", accuracy_options.structures, "hybrid, kd_tree, bvh, sbvh, tang2015, embree");
  accuracy->add_option("--rays", accuracy_options.rays, "Of each family")->check(CLI::Range(1, 10'000'000));
  accuracy->add_option("--rounds", accuracy_options.rounds, "Passes to take the median of")->check(CLI::Range(1, 1000));
  accuracy->add_option("--csv", accuracy_options.csv, "File to write; - is standard output");

  CLI11_PARSE(app, argc, argv);
  const absl::Status status = build->parsed()      ? deltaray::RunBuildBench(build_options)
                              : accuracy->parsed() ? deltaray::RunAccuracyBench(accuracy_options)
                              : kernel->parsed()   ? deltaray::RunKernelBench(kernel_options)
                              : scale->parsed()    ? deltaray::RunScaleBench(scale_options)
                              : service->parsed()  ? deltaray::RunServiceBench(service_options)
                              : stages->parsed()   ? deltaray::RunStagesBench(stages_options)
                                                   : deltaray::RunPaperBench(paper_options);
  if (status.ok()) return 0;
  std::cerr << "deltaray_bench: " << status.message() << '\n';
  return 1;
}
