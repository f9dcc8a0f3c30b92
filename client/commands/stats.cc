#include <memory>
#include <string>

#include "client/commands/commands.h"
#include "client/connection.h"
#include "client/mesh_key.h"
#include "client/message_text.h"
#include "client/output_file.h"
#include "client/stats_text.h"

namespace deltaray {
namespace {

struct StatsOptions {
  std::string mesh;
  DataFormat format = DataFormat::kTable;
};

absl::Status Stats(const StatsOptions& options, const Session& session) {
  auto connection = Connection::Open(session);
  if (!connection.ok()) return connection.status();
  v1::GetBuildStatsRequest request;
  request.set_mesh(options.mesh);
  v1::GetBuildStatsResponse response;
  absl::Status status = connection->CallAgain(request.mesh(), [&](grpc::ClientContext* context) {
    return connection->meshes().GetBuildStats(context, request, &response);
  });
  if (!status.ok()) return status;
  switch (options.format) {
    case DataFormat::kJson:
      return WriteOutput(session.output, JsonLine(response));
    case DataFormat::kCsv:
      return WriteOutput(session.output, CsvHeader(response) + CsvRow(response));
    default:
      return WriteOutput(session.output, BuildStatsText(response.id(), response.stats()));
  }
}

}  // namespace

void AddStatsCommand(CLI::App& app, CommandRun& run) {
  CLI::App& command = *app.add_subcommand("stats", "Print the statistics of a mesh's last build");
  auto options = std::make_shared<StatsOptions>();
  AddMeshArgument(command, [options](const std::string& mesh) { options->mesh = mesh; });
  AddFormatFlag(command, options->format);
  command.footer(
      "Examples:\n"
      "  deltaray stats bunny\n"
      "  deltaray stats bunny --format json | jq .stats.sah_cost");
  command.callback([options, &run] { run = [options](const Session& session) { return Stats(*options, session); }; });
}

}  // namespace deltaray
