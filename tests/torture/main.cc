// deltaray_torture: what servers are put through; see README.md.

#include <CLI/CLI.hpp>

#include "tests/torture/crash.h"
#include "tests/torture/history.h"

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

  CLI11_PARSE(app, argc, argv);
  if (crash->parsed()) return deltaray::TortureByCrashes(crash_options) ? 0 : 1;
  if (history->parsed()) return deltaray::TortureByHistory(history_options) ? 0 : 1;
  return 1;
}
