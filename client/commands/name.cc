#include <memory>
#include <string>

#include "client/commands/commands.h"
#include "client/connection.h"
#include "client/exit_code.h"
#include "client/mesh_key.h"

namespace deltaray {
namespace {

struct NameOptions {
  std::string name;
  std::string mesh;
  bool remove = false;
};

absl::Status Name(const NameOptions& options, const Session& session) {
  if (options.remove != options.mesh.empty()) {
    return UsageError(options.remove ? "--remove takes a name and no mesh" : "a mesh to name is missing");
  }
  auto connection = Connection::Open(session);
  if (!connection.ok()) return connection.status();
  v1::NameMeshRequest request;
  request.set_name(options.name);
  request.set_mesh(options.mesh);
  v1::NameMeshResponse response;
  absl::Status status = connection->CallOnce(request.mesh(), [&](grpc::ClientContext* context) {
    return connection->meshes().NameMesh(context, request, &response);
  });
  if (!status.ok() || response.previous_id().empty()) return status;
  return WriteMeshId(session, response.previous_id());
}

}  // namespace

void AddNameCommand(CLI::App& app, CommandRun& run) {
  CLI::App& command =
      *app.add_subcommand("name", "Point a name at a mesh, and print the id that it pointed at before, if any");
  auto options = std::make_shared<NameOptions>();
  command.add_option("NAME", options->name, "The name")->required()->check(Utf8);
  command.add_option("MESH", options->mesh, "Id or name of the mesh")->check(Utf8);
  command.add_flag("--remove", options->remove, "Take the name away; the mesh stays");
  command.footer(
      "Examples:\n"
      "  deltaray name current 3f5a…  (the id that upload printed)\n"
      "  deltaray name current bunny\n"
      "  deltaray name --remove current");
  command.callback([options, &run] { run = [options](const Session& session) { return Name(*options, session); }; });
}

}  // namespace deltaray
