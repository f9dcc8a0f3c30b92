#include <memory>
#include <string>

#include "client/build_flags.h"
#include "client/build_watcher.h"
#include "client/commands/commands.h"
#include "client/connection.h"
#include "client/mesh_key.h"

namespace deltaray {
namespace {

struct RebuildOptions {
  v1::RebuildMeshRequest request;
  bool wait = false;
};

absl::Status Rebuild(const RebuildOptions& options, const Session& session) {
  auto connection = Connection::Open(session);
  if (!connection.ok()) return connection.status();
  v1::RebuildMeshResponse response;
  absl::Status status = connection->CallOnce(options.request.mesh(), [&](grpc::ClientContext* context) {
    return connection->meshes().RebuildMesh(context, options.request, &response);
  });
  if (!status.ok()) return status;
  status = WriteMeshId(session, response.mesh().id());
  if (!status.ok() || !options.wait) return status;
  return WatchBuild(*connection, session, response.mesh().id());
}

}  // namespace

void AddRebuildCommand(CLI::App& app, CommandRun& run) {
  CLI::App& command =
      *app.add_subcommand("rebuild", "Build a mesh's tree anew with the given options, and print the mesh's id");
  auto options = std::make_shared<RebuildOptions>();
  AddMeshArgument(command, [options](const std::string& mesh) { options->request.set_mesh(mesh); });
  AddBuildFlags(command, [options]() -> v1::BuildOptions& { return *options->request.mutable_build_options(); });
  command.add_flag("--wait", options->wait, "Wait until the tree is built");
  command.footer(
      "Without options the tree is built as before. Where there are some, those that are not given take the preset's\n"
      "value, not that of the build before.\n"
      "Examples:\n"
      "  deltaray rebuild bunny --preset best --wait\n"
      "  deltaray rebuild bunny --builder tang2015 --delta 64 --alpha 0.6");
  command.callback([options, &run] { run = [options](const Session& session) { return Rebuild(*options, session); }; });
}

}  // namespace deltaray
