#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "client/build_watcher.h"
#include "client/commands/commands.h"
#include "client/connection.h"
#include "client/enum_names.h"
#include "client/mesh_key.h"
#include "client/message_text.h"
#include "client/output_file.h"
#include "client/text_table.h"

namespace deltaray {
namespace {

struct WatchOptions {
  std::string mesh;
  DataFormat format = DataFormat::kTable;
};

// How the build stands at its end, in one line.
std::string EndText(const v1::BuildProgress& progress) {
  return absl::StrCat(EnumName(progress.state()), ": build ", progress.build_number(), ", ",
                      GroupDigits(progress.triangles()), " triangles, ", GroupDigits(progress.delta_leaves_built()),
                      " of ", GroupDigits(progress.delta_leaves()), " δ-leaves, ",
                      SecondsText(progress.elapsed_seconds()), "\n");
}

absl::Status Watch(const WatchOptions& options, const Session& session) {
  auto connection = Connection::Open(session);
  if (!connection.ok()) return connection.status();
  v1::WatchBuildResponse last;
  bool first = true;
  absl::Status status =
      WatchBuild(*connection, session, options.mesh, [&](const v1::WatchBuildResponse& response) -> absl::Status {
        last = response;
        if (options.format == DataFormat::kJson) return WriteOutput(session.output, JsonLine(response));
        if (options.format == DataFormat::kTable) return absl::OkStatus();
        const std::string header = std::exchange(first, false) ? CsvHeader(response) : "";
        return WriteOutput(session.output, header + CsvRow(response));
      });
  if (!status.ok() || options.format != DataFormat::kTable) return status;
  return WriteOutput(session.output, EndText(last.progress()));
}

}  // namespace

void AddWatchCommand(CLI::App& app, CommandRun& run) {
  CLI::App& command = *app.add_subcommand("watch", "Follow the build of a mesh's tree to its end");
  auto options = std::make_shared<WatchOptions>();
  AddMeshArgument(command, [options](const std::string& mesh) { options->mesh = mesh; });
  AddFormatFlag(command, options->format);
  command.footer(
      "json and csv give one line a report; table gives one line at the end.\n"
      "Examples:\n"
      "  deltaray watch bunny\n"
      "  deltaray watch bunny --format csv > progress.csv");
  command.callback([options, &run] { run = [options](const Session& session) { return Watch(*options, session); }; });
}

}  // namespace deltaray
