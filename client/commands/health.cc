#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "client/commands/commands.h"
#include "client/connection.h"
#include "client/exit_code.h"
#include "client/mesh_key.h"
#include "client/named_option.h"
#include "client/output_file.h"

namespace deltaray {
namespace {

using grpc::health::v1::HealthCheckRequest;
using grpc::health::v1::HealthCheckResponse;

absl::Status Check(const std::string& mesh, const Session& session) {
  auto connection = Connection::Open(session);
  if (!connection.ok()) return connection.status();
  HealthCheckRequest request;
  if (!mesh.empty()) request.set_service(absl::StrCat("mesh/", mesh));
  HealthCheckResponse response;
  // Once, though it changes nothing: that the server is lost is an answer too, and no probe should wait for it.
  absl::Status status = connection->CallOnce(
      mesh, [&](grpc::ClientContext* context) { return connection->health().Check(context, request, &response); });
  if (!status.ok()) return status;
  if (response.status() != HealthCheckResponse::SERVING) {
    return LocalError(absl::StrCat(mesh.empty() ? "the server" : mesh, " does not serve now"));
  }
  return WriteOutput(session.output, "SERVING\n");
}

}  // namespace

void AddHealthCommand(CLI::App& app, CommandRun& run) {
  CLI::App& command = *app.add_subcommand("health", "Tell whether the server takes calls, or a mesh can be asked now");
  auto mesh = std::make_shared<std::string>();
  command.add_option("MESH", *mesh, "Id or name. Default: the server as a whole, which needs no token")
      ->check(NotEmpty)
      ->check(Utf8);
  command.footer(
      "Exit code 0: it serves; 1: it does not now. A mesh without a tree gets one built.\n"
      "\n"
      "Examples:\n"
      "  deltaray health\n"
      "  deltaray health bunny");
  command.callback([mesh, &run] { run = [mesh](const Session& session) { return Check(*mesh, session); }; });
}

}  // namespace deltaray
