// deltaray_torture: what servers are put through; see README.md.

#include <CLI/CLI.hpp>
#include <iostream>

#include "tests/torture/crash.h"
#include "tests/torture/history.h"
#include "tests/torture/load.h"
#include "tests/torture/probe.h"

int main(int argc, char** argv) {
  CLI::App app("Ill-treats servers, and checks what they answer.");
  app.require_subcommand(1);
  app.option_defaults()->always_capture_default();

  deltaray::CrashOptions crash_options;
  CLI::App* const crash = app.add_subcommand("crash", "Kills servers at random moments, and looks for what is lost.");
  crash->add_option("--binary", crash_options.binary, "deltarayd; default: the one beside this program");
  crash->add_option("--directory", crash_options.directory, "Data directory, empty")->required();
  crash->add_option("--servers", crash_options.servers, "That share the directory")->check(CLI::Range(1, 16));
  crash->add_option("--rounds", crash_options.rounds, "Kills and restarts")->check(CLI::Range(1, 1000000));
  crash->add_option("--seed", crash_options.seed, "Of all that is random");

  deltaray::HistoryOptions history_options;
  CLI::App* const history =
      app.add_subcommand("history", "Records what clients are answered under faults, and checks it.");
  history->add_option("--binary", history_options.binary, "deltarayd; default: the one beside this program");
  history->add_option("--directory", history_options.directory, "Data directory, empty")->required();
  history->add_option("--servers", history_options.servers, "That share the directory")->check(CLI::Range(1, 16));
  history->add_option("--seconds", history_options.seconds, "How long")->check(CLI::Range(1.0, 86400.0));
  history->add_option("--seed", history_options.seed, "Of all that is random");

  deltaray::LoadOptions load_options;
  CLI::App* const load = app.add_subcommand("load", "Many streams, fast and slow ones.");
  load->add_option("--server", load_options.server, "host:port")->required();
  load->add_option("--scene", load_options.scene, "Uploaded and traced");
  load->add_option("--seconds", load_options.seconds, "How long")->check(CLI::Range(0.1, 86400.0));
  load->add_option("--longest", load_options.longest, "Seconds that it may last until each stream had a batch")
      ->check(CLI::Range(0.0, 86400.0));
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
  if (crash->parsed()) return deltaray::TortureByCrashes(crash_options) ? 0 : 1;
  if (history->parsed()) return deltaray::TortureByHistory(history_options) ? 0 : 1;
  const absl::Status status = load->parsed()    ? deltaray::RunLoad(load_options)
                              : probe->parsed() ? deltaray::RunProbe(probe_options)
                                                : deltaray::RunSpeed(probe_options);
  if (status.ok()) return 0;
  std::cerr << "deltaray_torture: " << status.message() << '\n';
  return 1;
}
