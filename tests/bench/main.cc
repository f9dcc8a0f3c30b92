// deltaray_bench: measures building and tracing; see README.md.

#include <CLI/CLI.hpp>
#include <iostream>

#include "tests/bench/build_bench.h"
#include "tests/bench/paper_bench.h"

int main(int argc, char** argv) {
  CLI::App app("Measures how deltaray builds and traces. tests/bench/README.md explains the columns.");
  app.require_subcommand(1);
  app.option_defaults()->always_capture_default()->delimiter(',');

  deltaray::BuildBenchOptions build_options;
  build_options.scenes = {"bunny", "city", "soup"};
  build_options.engines = {"hybrid", "kd_tree", "bvh", "sbvh", "tang2015"};
  build_options.presets = {"balanced"};
  build_options.threads = {1, 2};
  build_options.csv = "-";
  CLI::App* const build = app.add_subcommand("build", "Time, size and SAH cost of the hybrid and the baselines.");
  build->add_option("--scenes", build_options.scenes, "Names of scenes");
  build->add_option("--engines", build_options.engines, "hybrid, kd_tree, bvh, sbvh, tang2015");
  build->add_option("--presets", build_options.presets, "fast, balanced, best");
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

  CLI11_PARSE(app, argc, argv);
  const absl::Status status =
      build->parsed() ? deltaray::RunBuildBench(build_options) : deltaray::RunPaperBench(paper_options);
  if (status.ok()) return 0;
  std::cerr << "deltaray_bench: " << status.message() << '\n';
  return 1;
}
