// The flags of deltarayd, and their variables in the environment.

#ifndef SERVER_FLAGS_H_
#define SERVER_FLAGS_H_

#include <string>

#include "CLI/CLI.hpp"
#include "absl/status/status.h"
#include "server/service/server.h"

namespace deltaray {

struct Flags {
  ServerOptions server;
  std::string port_file;
  std::string log_level = "info";
  std::string log_format = "text";
  bool insecure_listen = false;
  bool insecure_metrics_listen = false;
  double drain_seconds = 10;
  double idle_seconds = 300;
  double watchdog_seconds = 5;
};

// Adds all flags, and the rest of --help. `app` writes to `flags`, which outlives it.
void AddFlags(CLI::App& app, Flags& flags);

// Whether what was given fits together. Takes what `flags` has in seconds over to flags.server.
absl::Status FinishFlags(const CLI::App& app, Flags& flags);

// Tells the version and every flag, given or not. None of them is a secret: those name files.
void LogFlags(const CLI::App& app, const ServerOptions& server);

}  // namespace deltaray

#endif  // SERVER_FLAGS_H_
