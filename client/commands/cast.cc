#include <unistd.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "client/commands/commands.h"
#include "client/connection.h"
#include "client/enum_names.h"
#include "client/exit_code.h"
#include "client/hit_writer.h"
#include "client/input_file.h"
#include "client/mesh_key.h"
#include "client/named_option.h"
#include "client/progress_bar.h"
#include "client/query_flags.h"
#include "client/ray_reader.h"
#include "client/ray_stream.h"
#include "client/text_table.h"

namespace deltaray {
namespace {

struct CastOptions {
  v1::StreamStart start;
  std::string rays_path = "-";
  // Unset for CSV.
  std::optional<v1::RayLayout> raw_layout;
  std::vector<v1::HitColumn> columns;
  std::string exclude_path;
  size_t batch_rays = kDefaultBatchRays;
  HitFormat format = HitFormat::kCsv;
};

// The file of --exclude: one uint32 a ray, read along with the rays.
class ExcludedIds {
 public:
  explicit ExcludedIds(InputFile file) : file_(std::move(file)) {}

  // Fills in the ids of the next `count` rays.
  absl::Status Read(size_t count, std::string* ids) {
    ids->resize(count * sizeof(uint32_t));
    const absl::StatusOr<size_t> bytes = file_.Read(std::span(*ids));
    if (!bytes.ok()) return bytes.status();
    if (*bytes == ids->size()) return absl::OkStatus();
    return LocalError(absl::StrCat(file_.name(), ": ends at the id of ray ", rays_read_ + *bytes / sizeof(uint32_t)));
  }

  // Checks that there are no more ids than rays.
  absl::Status CheckEnd() {
    char extra;
    const absl::StatusOr<size_t> bytes = file_.ReadSome(std::span(&extra, 1));
    if (!bytes.ok()) return bytes.status();
    if (*bytes == 0) return absl::OkStatus();
    return LocalError(absl::StrCat(file_.name(), ": has more ids than there are rays, ", rays_read_));
  }

  void Advance(size_t count) { rays_read_ += count; }

 private:
  InputFile file_;
  uint64_t rays_read_ = 0;
};

absl::StatusOr<std::unique_ptr<ExcludedIds>> OpenExcluded(const CastOptions& options, const Session& session) {
  if (options.exclude_path.empty()) return nullptr;
  auto file = InputFile::Open(options.exclude_path, session);
  if (!file.ok()) return file.status();
  return std::make_unique<ExcludedIds>(*std::move(file));
}

absl::StatusOr<bool> ReadBatch(RayReader& rays, ExcludedIds* excluded, size_t limit, OutgoingBatch& batch) {
  const absl::StatusOr<size_t> count = rays.Read(limit, batch.rays.mutable_rays());
  if (!count.ok()) return count.status();
  batch.ray_count = *count;
  if (excluded != nullptr) {
    absl::Status status =
        *count == 0 ? excluded->CheckEnd() : excluded->Read(*count, batch.rays.mutable_excluded_primitive_ids());
    if (!status.ok()) return status;
    excluded->Advance(*count);
  }
  return *count > 0;
}

absl::Status Cast(const CastOptions& options, const Session& session) {
  v1::StreamStart start = options.start;
  v1::RayQuery& query = *start.mutable_query();
  if (query.max_hits_per_ray() != 0 && query.kind() != v1::QUERY_KIND_ALL_HITS) {
    return UsageError("--max-hits is for --kind all");
  }
  if (options.rays_path == "-" && options.exclude_path == "-") {
    return UsageError("the rays and --exclude cannot both be standard input");
  }
  const auto columns = ResolveColumns(query.kind(), options.columns);
  if (!columns.ok()) return columns.status();
  query.mutable_columns()->Add(columns->begin(), columns->end());

  const auto rays = OpenRays(options.rays_path, options.raw_layout, session);
  if (!rays.ok()) return rays.status();
  query.set_layout((*rays)->layout());
  if (absl::Status interval = CheckInterval(query); !interval.ok()) return interval;
  const auto excluded = OpenExcluded(options, session);
  if (!excluded.ok()) return excluded.status();
  auto connection = Connection::Open(session);
  if (!connection.ok()) return connection.status();

  HitWriter writer(options.format, query.kind(), *columns, session.output);
  // Not where the hits go to the same terminal.
  ProgressBar bar(session.messages, session.show_progress && !isatty(fileno(session.output)));
  uint64_t answered = 0;
  const absl::Status status = StreamBatches(
      *connection, start,
      [&](OutgoingBatch& batch) { return ReadBatch(**rays, excluded->get(), options.batch_rays, batch); },
      [&](const v1::HitBatch& hits) {
        answered += hits.ray_count();
        bar.Update(-1, absl::StrCat(GroupDigits(answered), " rays answered"));
        return writer.Write(hits);
      });
  return status.ok() ? writer.End() : status;
}

// "t,uv"; throws for CLI11 to report.
std::vector<v1::HitColumn> ParseColumns(const std::string& text) {
  const NamedValues<v1::HitColumn> known = EnumValues<v1::HitColumn>();
  std::vector<v1::HitColumn> columns;
  for (const absl::string_view name : absl::StrSplit(text, ',')) {
    const auto it = std::find_if(known.begin(), known.end(), [&](const auto& named) { return named.first == name; });
    if (it == known.end()) throw CLI::ValidationError("--columns", absl::StrCat("there is no column '", name, "'"));
    columns.push_back(it->second);
  }
  return columns;
}

}  // namespace

void AddCastCommand(CLI::App& app, CommandRun& run) {
  CLI::App& command = *app.add_subcommand("cast", "Cast rays at a mesh and print the hits");
  auto options = std::make_shared<CastOptions>();
  v1::RayQuery& query = *options->start.mutable_query();
  query.set_kind(v1::QUERY_KIND_CLOSEST_HIT);
  AddMeshArgument(command, [options](const std::string& mesh) { options->start.set_mesh(mesh); });
  command.add_option("RAYS", options->rays_path, "File of rays; - for standard input")->capture_default_str();
  AddRaysFormatFlag(command, options->raw_layout);
  AddNamedOption<v1::QueryKind>(
      command, "--kind",
      {{"closest", v1::QUERY_KIND_CLOSEST_HIT},
       {"any", v1::QUERY_KIND_ANY_HIT},
       {"all", v1::QUERY_KIND_ALL_HITS},
       {"count", v1::QUERY_KIND_COUNT_HITS}},
      [&query](v1::QueryKind kind) { query.set_kind(kind); }, "What to ask of every ray [closest]");
  command
      .add_option_function<std::string>(
          "--columns", [options](const std::string& text) { options->columns = ParseColumns(text); },
          "Columns wanted, separated by commas: t, primitive_id, face_id, group_id, uv, normal, flags, count "
          "[all that the kind has, but face_id, group_id and normal]")
      ->type_name("LIST");
  command
      .add_option_function<uint32_t>(
          "--max-hits", [&query](const uint32_t& hits) { query.set_max_hits_per_ray(hits); },
          "--kind all: most hits a ray, the nearest ones; the count is of all [64]")
      ->check(CLI::Range(1, 65536))
      ->type_name("N");
  command.add_option("--exclude", options->exclude_path,
                     "File of one uint32 a ray: the triangle that the ray ignores; 4294967295 for none");
  AddQueryFlags(command, query, options->batch_rays);
  AddNamedOption<HitFormat>(
      command, "--format",
      {{"csv", HitFormat::kCsv}, {"json", HitFormat::kJson}, {"table", HitFormat::kTable}, {"raw", HitFormat::kRaw}},
      [options](HitFormat format) { options->format = format; }, "Format of the hits [csv]");
  command.footer(
      "CSV rays have the columns ox,oy,oz,dx,dy,dz[,t_min,t_max], with or without a header.\n"
      "Examples:\n"
      "  echo 0,0,5,0,0,-1 | deltaray cast bunny\n"
      "  deltaray cast bunny rays.csv --kind all --max-hits 8 --format json\n"
      "  deltaray cast bunny rays.f32 --rays-format f32x6 --columns t --format raw > t.f32\n"
      "  deltaray cast bunny bounces.csv --exclude starts.u32 --kind any");
  command.callback([options, &run] { run = [options](const Session& session) { return Cast(*options, session); }; });
}

}  // namespace deltaray
