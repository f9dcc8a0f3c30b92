#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "absl/strings/str_cat.h"
#include "client/build_flags.h"
#include "client/build_watcher.h"
#include "client/commands/commands.h"
#include "client/connection.h"
#include "client/enum_names.h"
#include "client/exit_code.h"
#include "client/file_digest.h"
#include "client/input_file.h"
#include "client/mesh_key.h"
#include "client/named_option.h"
#include "client/output_file.h"
#include "client/progress_bar.h"
#include "client/retry.h"
#include "client/text_table.h"

namespace deltaray {
namespace {

constexpr size_t kChunkBytes = 1 << 20;

struct UploadOptions {
  std::string path;
  v1::UploadHeader header;
  bool wait = false;
};

absl::Status CheckRawLayout(const v1::UploadHeader& header) {
  const bool raw = header.format() == v1::MESH_FORMAT_RAW;
  if (raw == header.has_raw_layout()) return absl::OkStatus();
  return UsageError(raw ? "--format raw needs --vertices and --triangles"
                        : "--vertices, --triangles and --positions are for --format raw");
}

// Sends the file in chunks. Returns early, with OK, where the server takes no more: Finish() tells why.
absl::Status SendChunks(InputFile& file, grpc::ClientWriter<v1::UploadMeshRequest>& writer, ProgressBar& bar) {
  uint64_t sent = 0;
  v1::UploadMeshRequest request;
  while (true) {
    std::string& chunk = *request.mutable_chunk();
    chunk.resize(kChunkBytes);
    const absl::StatusOr<size_t> count = file.Read(std::span(chunk));
    if (!count.ok()) return count.status();
    if (*count == 0) break;
    chunk.resize(*count);
    if (!writer.Write(request)) return absl::OkStatus();
    sent += *count;
    bar.Update(file.size() && *file.size() > 0 ? static_cast<double>(sent) / *file.size() : -1,
               absl::StrCat("sent ", BytesText(sent)));
  }
  writer.WritesDone();
  return absl::OkStatus();
}

// Runs one UploadMesh RPC; what it ended with goes to `rpc_status`. Fails where the file cannot be read.
absl::Status SendOnce(Connection& connection, const Session& session, InputFile& file, const v1::UploadHeader& header,
                      v1::UploadMeshResponse* response, grpc::Status* rpc_status) {
  grpc::ClientContext context;
  connection.Prepare(header.name(), &context);
  const StopSignal::Scope scope(session.stop, context);
  const auto writer = connection.meshes().UploadMesh(&context, response);
  v1::UploadMeshRequest first;
  *first.mutable_header() = header;
  writer->Write(first);
  ProgressBar bar(session.messages, session.show_progress);
  const absl::Status sent = SendChunks(file, *writer, bar);
  // Without the cancellation the server would take the half that it got for the whole.
  if (!sent.ok()) context.TryCancel();
  *rpc_status = WithRequestId(writer->Finish(), context);
  return sent;
}

absl::Status SendFile(Connection& connection, const Session& session, InputFile& file, const v1::UploadHeader& header,
                      v1::UploadMeshResponse* response) {
  // The same mesh twice is one mesh. A name, though, would be taken from who got it in between.
  const bool repeatable = file.size().has_value() && header.name().empty();
  Retry retry(connection);
  while (true) {
    grpc::Status rpc_status;
    absl::Status status = SendOnce(connection, session, file, header, response, &rpc_status);
    if (!status.ok()) return status;
    if (!repeatable || !retry.Again(rpc_status)) return connection.Result(rpc_status);
    status = file.Rewind();
    if (!status.ok()) return status;
  }
}

// For people: what was stored, and what was noticed in the file.
absl::Status TellUploaded(const Session& session, const std::string& file, const v1::UploadMeshResponse& response) {
  const v1::Mesh& mesh = response.mesh();
  std::string text =
      absl::StrCat(Printable(file), response.created() ? ": stored, " : ": was there already, ",
                   GroupDigits(mesh.vertex_count()), " vertices, ", GroupDigits(mesh.triangle_count()), " triangles\n");
  for (const std::string& warning : mesh.warnings()) absl::StrAppend(&text, "warning: ", Printable(warning), "\n");
  return WriteOutput(session.messages, text, "standard error");
}

absl::Status Upload(const UploadOptions& options, const Session& session) {
  absl::Status status = CheckRawLayout(options.header);
  if (!status.ok()) return status;
  auto file = InputFile::Open(options.path, session);
  if (!file.ok()) return file.status();
  auto connection = Connection::Open(session);
  if (!connection.ok()) return connection.status();

  v1::UploadHeader header = options.header;
  if (file->size()) {
    header.set_size_bytes(*file->size());
    absl::StatusOr<std::string> digest = Sha256OfRest(*file);
    if (!digest.ok()) return digest.status();
    header.set_sha256(*std::move(digest));
    status = file->Rewind();
    if (!status.ok()) return status;
  }
  v1::UploadMeshResponse response;
  status = SendFile(*connection, session, *file, header, &response);
  if (!status.ok()) return status;
  // The id goes out before all else: the mesh is stored, whether or not the rest can be told, and however the build
  // ends.
  status = WriteMeshId(session, response.mesh().id());
  if (!response.mesh().id().empty()) status.Update(TellUploaded(session, file->name(), response));
  if (!status.ok() || !options.wait) return status;
  return WatchBuild(*connection, session, response.mesh().id());
}

void AddRawLayoutFlags(CLI::App& command, v1::UploadHeader& header) {
  const char* const group = "Layout of --format raw";
  command
      .add_option_function<uint64_t>(
          "--vertices", [&header](const uint64_t& count) { header.mutable_raw_layout()->set_vertex_count(count); },
          "Number of vertices")
      ->check(WholeNumber)
      ->group(group);
  command
      .add_option_function<uint64_t>(
          "--triangles", [&header](const uint64_t& count) { header.mutable_raw_layout()->set_triangle_count(count); },
          "Number of triangles")
      ->check(WholeNumber)
      ->group(group);
  AddEnumOption<v1::ScalarType>(
      command, "--positions", [&header](v1::ScalarType type) { header.mutable_raw_layout()->set_position_type(type); },
      "Type of the coordinates [float32]")
      ->group(group);
  command.get_option("--vertices")->needs(command.get_option("--triangles"));
  command.get_option("--triangles")->needs(command.get_option("--vertices"));
  command.get_option("--positions")->needs(command.get_option("--vertices"));
}

}  // namespace

void AddUploadCommand(CLI::App& app, CommandRun& run) {
  CLI::App& command = *app.add_subcommand("upload", "Upload a mesh and print its id");
  auto options = std::make_shared<UploadOptions>();
  command.add_option("FILE", options->path, "OBJ, PLY, STL or raw file; - for standard input")->required();
  command
      .add_option_function<std::string>(
          "--name", [options](const std::string& name) { options->header.set_name(name); }, "Name to give to the mesh")
      ->check(Utf8);
  AddEnumOption<v1::MeshFormat>(
      command, "--format", [options](v1::MeshFormat format) { options->header.set_format(format); },
      "Format of the file [detected: obj, ply or stl]");
  AddRawLayoutFlags(command, options->header);
  // Not before a flag is given: a mesh that is already there keeps its tree unless the header has build options.
  AddBuildFlags(command, [options]() -> v1::BuildOptions& { return *options->header.mutable_build_options(); });
  command.add_flag("--wait", options->wait, "Wait until the tree is built");
  command.footer(
      "A mesh that is already there keeps its tree, unless options ask for another one.\n"
      "Examples:\n"
      "  deltaray upload bunny.obj --name bunny --wait\n"
      "  zcat dragon.ply.gz | deltaray upload - --format ply --preset best\n"
      "  deltaray upload terrain.bin --format raw --positions float64 --vertices 4 --triangles 2");
  command.callback([options, &run] { run = [options](const Session& session) { return Upload(*options, session); }; });
}

}  // namespace deltaray
