#include <memory>
#include <string>

#include "client/commands/commands.h"
#include "client/connection.h"
#include "client/mesh_key.h"
#include "client/mesh_text.h"
#include "client/message_text.h"
#include "client/output_file.h"

namespace deltaray {
namespace {

struct ShowOptions {
  std::string mesh;
  DataFormat format = DataFormat::kTable;
};

absl::Status Show(const ShowOptions& options, const Session& session) {
  auto connection = Connection::Open(session);
  if (!connection.ok()) return connection.status();
  v1::GetMeshRequest request;
  request.set_mesh(options.mesh);
  v1::GetMeshResponse response;
  absl::Status status = connection->CallAgain(request.mesh(), [&](grpc::ClientContext* context) {
    return connection->meshes().GetMesh(context, request, &response);
  });
  if (!status.ok()) return status;
  switch (options.format) {
    case DataFormat::kJson:
      return WriteOutput(session.output, JsonLine(response.mesh()));
    case DataFormat::kCsv:
      return WriteOutput(session.output, CsvHeader(response.mesh()) + CsvRow(response.mesh()));
    default:
      return WriteOutput(session.output, MeshText(response.mesh()));
  }
}

}  // namespace

void AddShowCommand(CLI::App& app, CommandRun& run) {
  CLI::App& command = *app.add_subcommand("show", "Show all about one mesh");
  auto options = std::make_shared<ShowOptions>();
  AddMeshArgument(command, [options](const std::string& mesh) { options->mesh = mesh; });
  AddFormatFlag(command, options->format);
  command.footer(
      "Examples:\n"
      "  deltaray show bunny\n"
      "  deltaray show bunny --format json | jq .bounds");
  command.callback([options, &run] { run = [options](const Session& session) { return Show(*options, session); }; });
}

}  // namespace deltaray
