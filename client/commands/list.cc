#include <memory>
#include <set>
#include <string>

#include "client/commands/commands.h"
#include "client/connection.h"
#include "client/exit_code.h"
#include "client/mesh_text.h"
#include "client/message_text.h"
#include "client/output_file.h"

namespace deltaray {
namespace {

constexpr uint32_t kPageSize = 1000;

std::string PageText(const v1::ListMeshesResponse& page, DataFormat format) {
  std::string text;
  for (const v1::Mesh& mesh : page.meshes()) text += format == DataFormat::kJson ? JsonLine(mesh) : CsvRow(mesh);
  return text;
}

absl::Status List(DataFormat format, const Session& session) {
  auto connection = Connection::Open(session);
  if (!connection.ok()) return connection.status();
  if (format == DataFormat::kCsv) {
    absl::Status status = WriteOutput(session.output, CsvHeader(v1::Mesh()));
    if (!status.ok()) return status;
  }
  // JSON and CSV go out page by page. The table waits for all, since its widths depend on every row.
  v1::ListMeshesResponse all;
  v1::ListMeshesRequest request;
  request.set_page_size(kPageSize);
  std::set<std::string> tokens;
  do {
    v1::ListMeshesResponse page;
    absl::Status status = connection->CallAgain(
        "", [&](grpc::ClientContext* context) { return connection->meshes().ListMeshes(context, request, &page); });
    if (!status.ok()) return status;
    request.set_page_token(page.next_page_token());
    // The same pages would come for ever.
    if (!tokens.insert(page.next_page_token()).second) {
      return LocalError("the server's answer has the token of a page that was there already");
    }
    if (format == DataFormat::kTable) {
      all.MergeFrom(page);
    } else {
      status = WriteOutput(session.output, PageText(page, format));
      if (!status.ok()) return status;
    }
  } while (!request.page_token().empty());
  return WriteOutput(session.output, MeshListText(all.meshes()));
}

}  // namespace

void AddListCommand(CLI::App& app, CommandRun& run) {
  CLI::App& command = *app.add_subcommand("list", "List all meshes");
  auto format = std::make_shared<DataFormat>(DataFormat::kTable);
  AddFormatFlag(command, *format);
  command.footer(
      "Examples:\n"
      "  deltaray list\n"
      "  deltaray list --format json | jq -r .id");
  command.callback([format, &run] { run = [format](const Session& session) { return List(*format, session); }; });
}

}  // namespace deltaray
