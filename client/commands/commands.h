// The commands of the program, one file each.

#ifndef CLIENT_COMMANDS_COMMANDS_H_
#define CLIENT_COMMANDS_COMMANDS_H_

#include <functional>
#include <string>

#include "CLI/App.hpp"
#include "absl/status/status.h"
#include "client/session.h"

namespace deltaray {

// What the command line asks for.
using CommandRun = std::function<absl::Status(const Session&)>;

// Each adds one command to `app`; parsing it sets `run`. Both must outlive the parsing.
void AddUploadCommand(CLI::App& app, CommandRun& run);
void AddListCommand(CLI::App& app, CommandRun& run);
void AddShowCommand(CLI::App& app, CommandRun& run);
void AddNameCommand(CLI::App& app, CommandRun& run);
void AddWatchCommand(CLI::App& app, CommandRun& run);
void AddStatsCommand(CLI::App& app, CommandRun& run);
void AddRebuildCommand(CLI::App& app, CommandRun& run);
void AddDeleteCommand(CLI::App& app, CommandRun& run);
void AddCastCommand(CLI::App& app, CommandRun& run);
void AddRenderCommand(CLI::App& app, CommandRun& run);
void AddChartCommand(CLI::App& app, CommandRun& run);
void AddHealthCommand(CLI::App& app, CommandRun& run);

}  // namespace deltaray

#endif  // CLIENT_COMMANDS_COMMANDS_H_
