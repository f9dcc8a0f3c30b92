#include <memory>
#include <string>

#include "client/commands/commands.h"
#include "client/connection.h"
#include "client/mesh_key.h"

namespace deltaray {
namespace {

absl::Status Delete(const std::string& mesh, const Session& session) {
  auto connection = Connection::Open(session);
  if (!connection.ok()) return connection.status();
  v1::DeleteMeshRequest request;
  request.set_mesh(mesh);
  v1::DeleteMeshResponse response;
  absl::Status status = connection->CallOnce(
      mesh, [&](grpc::ClientContext* context) { return connection->meshes().DeleteMesh(context, request, &response); });
  if (!status.ok()) return status;
  return WriteMeshId(session, response.id());
}

}  // namespace

void AddDeleteCommand(CLI::App& app, CommandRun& run) {
  CLI::App& command = *app.add_subcommand("delete", "Delete a mesh with all its names, and print its id");
  auto mesh = std::make_shared<std::string>();
  AddMeshArgument(command, [mesh](const std::string& key) { *mesh = key; });
  command.footer(
      "Example:\n"
      "  deltaray delete bunny");
  command.callback([mesh, &run] { run = [mesh](const Session& session) { return Delete(*mesh, session); }; });
}

}  // namespace deltaray
