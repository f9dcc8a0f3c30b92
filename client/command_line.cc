#include "client/command_line.h"

#include <sstream>
#include <string>

#include "CLI/App.hpp"
#include "CLI/Config.hpp"
#include "CLI/Formatter.hpp"
#include "absl/strings/str_cat.h"
#include "client/commands/commands.h"
#include "client/exit_code.h"
#include "client/named_option.h"
#include "client/output_file.h"
#include "client/server_address.h"
#include "client/text_table.h"

namespace deltaray {
namespace {

void AddCommands(CLI::App& app, CommandRun& run) {
  AddUploadCommand(app, run);
  AddListCommand(app, run);
  AddShowCommand(app, run);
  AddNameCommand(app, run);
  AddWatchCommand(app, run);
  AddStatsCommand(app, run);
  AddRebuildCommand(app, run);
  AddDeleteCommand(app, run);
  AddCastCommand(app, run);
  AddRenderCommand(app, run);
  AddChartCommand(app, run);
  AddHealthCommand(app, run);
  app.require_subcommand(1);
  // --server and --timeout may also stand behind the command.
  for (CLI::App* command : app.get_subcommands({})) command->fallthrough();
}

void AddGlobalFlags(CLI::App& app, Session& session) {
  app.add_option("--server", session.server, "Address of deltarayd")
      ->envname("DELTARAY_SERVER")
      ->check([](const std::string& address) { return Printable(WrongWithServerAddress(address)); })
      ->type_name("HOST:PORT")
      ->capture_default_str();
  app.add_option("--timeout", session.timeout_seconds,
                 "Time to connect, and for each request that is not a stream, in seconds")
      ->check(CLI::Range(0.001, 86400.0))
      ->check(NotNan)
      ->type_name("SECONDS")
      ->capture_default_str();
  app.add_option("--retry-for", session.retry_seconds,
                 "Time to ask again for what changes nothing, while a server that was reached is lost, in seconds; 0: "
                 "never")
      ->envname("DELTARAY_RETRY_FOR")
      ->check(CLI::Range(0.0, 86400.0))
      ->check(NotNan)
      ->type_name("SECONDS")
      ->capture_default_str();
  AddSecurityFlags(app, session.security);
  app.set_version_flag("--version", "deltaray " DELTARAY_VERSION);
}

// Tells why a command has failed, and returns its exit code.
int Exit(const absl::Status& status, const Session& session) {
  if (!status.ok() && !IsOutputClosed(status)) {
    (void)WriteOutput(session.messages, absl::StrCat("deltaray: ", ErrorText(status), "\n"));
  }
  return ExitCode(status);
}

}  // namespace

int RunCommandLine(int argc, const char* const* argv, Session& session) {
  CLI::App app("Ray queries on triangle meshes: the client of deltarayd.", "deltaray");
  AddGlobalFlags(app, session);
  CommandRun run;
  AddCommands(app, run);
  app.footer(
      "Exit codes: 0 success, 1 local failure, 2 usage, 64 + gRPC code where the server refused (NOT_FOUND: 69).\n"
      "Each command has its own --help with examples. To begin:\n"
      "  deltaray upload bunny.obj --name bunny --wait && deltaray render bunny -o bunny.png");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    std::ostringstream output;
    std::ostringstream messages;
    const int code = app.exit(error, output, messages);
    if (code != 0 && app.get_subcommands().empty() && !app.remaining().empty()) {
      messages.str(absl::StrCat("There is no command '", Printable(app.remaining().front()),
                                "'\nRun with --help for more information.\n"));
    }
    if (code == 0) return Exit(WriteOutput(session.output, output.str()), session);
    // Where even this cannot be written, there is nowhere left to say so.
    (void)WriteOutput(session.messages, messages.str());
    return kExitUsage;
  }
  return Exit(run(session), session);
}

}  // namespace deltaray
