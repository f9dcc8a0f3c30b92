#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "client/accuracy_chart.h"
#include "client/accuracy_text.h"
#include "client/build_watcher.h"
#include "client/commands/commands.h"
#include "client/connection.h"
#include "client/exit_code.h"
#include "client/generated_rays.h"
#include "client/mesh_key.h"
#include "client/message_text.h"
#include "client/named_option.h"
#include "client/output_file.h"
#include "client/query_flags.h"
#include "client/ray_reader.h"
#include "client/text_table.h"

namespace deltaray {
namespace {

const NamedValues<GeneratedRays> kGeneratedRays = {{"camera", GeneratedRays::kCamera},
                                                   {"chords", GeneratedRays::kChords},
                                                   {"bounce", GeneratedRays::kBounce},
                                                   {"shadow", GeneratedRays::kShadow}};

// Bytes of a message that are left for all but the rays: the id of a mesh and the query take fewer.
constexpr size_t kQueryBytes = 1024;

struct ChartOptions {
  v1::CompareAccuracyRequest request;
  std::string output_path;
  std::string csv_path;
  std::string rays_path;
  std::optional<v1::RayLayout> raw_layout;
  GeneratedRays generated = GeneratedRays::kBounce;
  uint32_t count = 100'000;
  uint64_t seed = 1;
  double max_wrong_per_million = 0;
  DataFormat format = DataFormat::kTable;
};

// All rays of the file: they make one batch.
absl::Status ReadRays(const ChartOptions& options, const Session& session, v1::CompareAccuracyRequest* request) {
  const auto rays = OpenRays(options.rays_path, options.raw_layout, session);
  if (!rays.ok()) return rays.status();
  request->mutable_query()->set_layout((*rays)->layout());
  if (absl::Status interval = CheckInterval(request->query()); !interval.ok()) return interval;
  const size_t ray_bytes = RayBytes((*rays)->layout());
  const size_t most = std::min(kMaxBatchRays, (kMaxMessageBytes - kQueryBytes) / ray_bytes);
  std::string* const bytes = request->mutable_rays()->mutable_rays();
  size_t count = 0;
  while (true) {
    // One ray beyond the limit tells that there are too many.
    const absl::StatusOr<size_t> read = (*rays)->Read(most + 1 - count, bytes);
    if (!read.ok()) return read.status();
    if (*read == 0) break;
    count += *read;
    if (count > most) {
      return LocalError(absl::StrCat(options.rays_path, ": has more than ", GroupDigits(most), " rays of ", ray_bytes,
                                     " bytes, the most of a batch"));
    }
  }
  return count > 0 ? absl::OkStatus() : LocalError(absl::StrCat(options.rays_path, ": has no rays"));
}

std::string RaysText(const ChartOptions& options) {
  if (!options.rays_path.empty()) return absl::StrCat("rays of ", options.rays_path);
  for (const auto& [name, kind] : kGeneratedRays) {
    if (kind == options.generated) return absl::StrCat(name, " rays");
  }
  return "rays";
}

absl::Status CheckReply(const v1::CompareAccuracyResponse& response) {
  bool good = response.ray_count() > 0 && !response.levels().empty();
  for (const v1::AccuracyMeasurement& level : response.levels()) {
    good = good && std::isfinite(level.nanoseconds_per_ray()) && level.nanoseconds_per_ray() >= 0;
  }
  return good ? absl::OkStatus() : LocalError("the server's reply has no rays, no levels, or no times");
}

absl::Status WriteResult(const ChartOptions& options, const Session& session,
                         const v1::CompareAccuracyResponse& response) {
  const std::string choice = CheapestLevelText(response, options.max_wrong_per_million);
  const std::string title = absl::StrCat("Speed against accuracy: ", options.request.mesh(), ", ",
                                         GroupDigits(response.ray_count()), " ", RaysText(options));
  absl::Status status = WriteWholeFile(options.output_path, AccuracyChartSvg(title, choice, response));
  if (status.ok() && !options.csv_path.empty()) status = WriteWholeFile(options.csv_path, AccuracyCsv(response));
  if (!status.ok()) return status;
  if (options.format == DataFormat::kTable) {
    return WriteOutput(session.output, absl::StrCat(AccuracyText(response), "\n", choice, "\n"));
  }
  status =
      WriteOutput(session.output, options.format == DataFormat::kJson ? JsonLine(response) : AccuracyCsv(response));
  // Not among data that a program reads.
  return status.ok() ? WriteOutput(session.messages, choice + "\n", "standard error") : status;
}

// Rays that bounce off what is convex hit nothing, and a choice by such rays would be taken for more than it is.
absl::Status WarnOfNoHits(const Session& session, const v1::CompareAccuracyResponse& response) {
  if (response.hit_count() > 0) return absl::OkStatus();
  return WriteOutput(session.messages,
                     "warning: none of the rays hits the mesh, so that the choice says nothing of hits; try --generate "
                     "chords or camera, or other --rays\n",
                     "standard error");
}

// However they are spelt. Either may not be there yet.
bool IsSameFile(const std::string& a, const std::string& b) {
  std::error_code a_error, b_error;
  return std::filesystem::weakly_canonical(a, a_error) == std::filesystem::weakly_canonical(b, b_error) && !a_error &&
         !b_error;
}

absl::Status Chart(const ChartOptions& options, const Session& session) {
  if (!options.csv_path.empty() && IsSameFile(options.csv_path, options.output_path)) {
    return UsageError(absl::StrCat("--csv and --output would both be written to ", options.csv_path));
  }
  v1::CompareAccuracyRequest request = options.request;
  if (!options.rays_path.empty()) {
    if (absl::Status status = ReadRays(options, session, &request); !status.ok()) return status;
  }
  auto connection = Connection::Open(session);
  if (!connection.ok()) return connection.status();
  v1::GetMeshRequest get;
  get.set_mesh(request.mesh());
  v1::GetMeshResponse mesh;
  absl::Status status = connection->CallAgain(
      get.mesh(), [&](grpc::ClientContext* context) { return connection->meshes().GetMesh(context, get, &mesh); });
  if (!status.ok()) return status;
  // By id, so that a name that moves meanwhile does not bring in another mesh.
  request.set_mesh(mesh.mesh().id());
  // Here, where it is shown, and not within the time that the measuring may take.
  status = WatchBuild(*connection, session, request.mesh());
  if (!status.ok()) return status;
  if (options.rays_path.empty()) {
    status = GenerateRays(*connection, mesh.mesh(), options.generated, options.count, options.seed, &request);
    if (!status.ok()) return status;
  }
  v1::CompareAccuracyResponse response;
  status = connection->CallAgain(request.mesh(), [&](grpc::ClientContext* context) {
    return connection->rays().CompareAccuracy(context, request, &response);
  });
  if (!status.ok()) return status;
  status = CheckReply(response);
  if (status.ok()) status = WriteResult(options, session, response);
  return status.ok() ? WarnOfNoHits(session, response) : status;
}

// Standard output is taken by what --format says.
std::string NotStandardOutput(const std::string& path) {
  return IsStandardOutput(path) ? "the measurements go to standard output; name a file" : "";
}

void AddRaysFlags(CLI::App& command, ChartOptions& options) {
  CLI::Option* const rays = command.add_option("--rays", options.rays_path, "File of rays; - for standard input");
  AddRaysFormatFlag(command, options.raw_layout);
  AddNamedOption<GeneratedRays>(
      command, "--generate", kGeneratedRays, [&options](GeneratedRays kind) { options.generated = kind; },
      "Rays to make where there is no --rays [bounce]")
      ->excludes(rays);
  command.add_option("--count", options.count, "How many to make")
      ->check(CLI::Range(size_t{1}, kMaxBatchRays))
      ->type_name("N")
      ->capture_default_str()
      ->excludes(rays);
  command.add_option("--seed", options.seed, "What they are made from")
      ->check(WholeNumber)
      ->capture_default_str()
      ->excludes(rays);
}

}  // namespace

void AddChartCommand(CLI::App& app, CommandRun& run) {
  CLI::App& command = *app.add_subcommand("chart", "Chart speed against accuracy for a mesh and rays");
  auto options = std::make_shared<ChartOptions>();
  v1::RayQuery& query = *options->request.mutable_query();
  AddMeshArgument(command, [options](const std::string& mesh) { options->request.set_mesh(mesh); });
  command.add_option("-o,--output", options->output_path, "SVG file to write")
      ->required()
      ->check(NotStandardOutput)
      ->check(NotEmpty)
      ->check(NoOtherExtension(".svg"));
  command.add_option("--csv", options->csv_path, "CSV file to write, a row a level")
      ->check(NotStandardOutput)
      ->check(NotEmpty);
  AddRaysFlags(command, *options);
  AddNamedOption<v1::QueryKind>(
      command, "--kind", {{"closest", v1::QUERY_KIND_CLOSEST_HIT}, {"any", v1::QUERY_KIND_ANY_HIT}},
      [&query](v1::QueryKind kind) { query.set_kind(kind); }, "What to ask of every ray [closest]");
  AddRayFlags(command, query);
  command
      .add_option_function<uint32_t>(
          "--rounds", [options](const uint32_t& rounds) { options->request.set_rounds(rounds); },
          "How often to time each level [5]")
      ->check(CLI::Range(1, 32))
      ->type_name("N");
  command.add_option("--max-wrong-per-million", options->max_wrong_per_million, "Wrong answers that you can live with")
      ->check(CLI::Range(0.0, 1e6))
      ->check(NotNan)
      ->type_name("X")
      ->capture_default_str();
  AddFormatFlag(command, options->format);
  command.footer(
      "The server traces the rays at each accuracy level and takes the exact one for the truth.\n"
      "Many rays take longer than the default --timeout.\n"
      "Examples:\n"
      "  deltaray chart bunny -o bunny.svg\n"
      "  deltaray chart bunny -o bunny.svg --generate shadow --kind any --count 1000000 --timeout 120\n"
      "  deltaray chart city -o city.svg --rays rays.csv --csv city.csv --max-wrong-per-million 5");
  command.callback([options, &run] { run = [options](const Session& session) { return Chart(*options, session); }; });
}

}  // namespace deltaray
