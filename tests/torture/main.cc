// deltaray_torture: puts load on a server that a script has started; see README.md.

#include <CLI/CLI.hpp>
#include <iostream>

#include "tests/torture/load.h"
#include "tests/torture/probe.h"

int main(int argc, char** argv) {
  CLI::App app("Puts load on a deltarayd, and measures it meanwhile. tests/torture/README.md explains the lines.");
  app.require_subcommand(1);
  app.option_defaults()->always_capture_default();

  deltaray::LoadOptions load_options;
  CLI::App* const load = app.add_subcommand("load", "Many streams, fast and slow ones.");
  load->add_option("--server", load_options.server, "host:port")->required();
  load->add_option("--scene", load_options.scene, "Uploaded and traced");
  load->add_option("--seconds", load_options.seconds, "How long")->check(CLI::Range(0.1, 86400.0));
  load->add_option("--streams", load_options.streams, "Streams that read at once")->check(CLI::Range(0, 4096));
  load->add_option("--slow", load_options.slow, "Streams that take one reply a second")->check(CLI::Range(0, 4096));
  load->add_option("--max-batch", load_options.max_batch, "Rays of the largest batches")
      ->check(CLI::Range(256, 1 << 24));

  deltaray::ProbeOptions probe_options;
  CLI::App* const probe = app.add_subcommand("probe", "How soon small calls and health checks are answered.");
  CLI::App* const speed = app.add_subcommand("speed", "Rays per second of one stream.");
  for (CLI::App* const command : {probe, speed}) {
    command->add_option("--server", probe_options.server, "host:port")->required();
    command->add_option("--scene", probe_options.scene, "Uploaded and traced");
    command->add_option("--seconds", probe_options.seconds, "How long")->check(CLI::Range(0.1, 86400.0));
  }
  probe->add_option("--rays", probe_options.rays, "Rays of a call")->check(CLI::Range(1, 1 << 20));

  CLI11_PARSE(app, argc, argv);
  const absl::Status status = load->parsed()    ? deltaray::RunLoad(load_options)
                              : probe->parsed() ? deltaray::RunProbe(probe_options)
                                                : deltaray::RunSpeed(probe_options);
  if (status.ok()) return 0;
  std::cerr << "deltaray_torture: " << status.message() << '\n';
  return 1;
}
