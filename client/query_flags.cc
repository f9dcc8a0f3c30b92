#include "client/query_flags.h"

#include "client/enum_names.h"
#include "client/exit_code.h"
#include "client/named_option.h"

namespace deltaray {
void AddRayFlags(CLI::App& command, v1::RayQuery& query) {
  AddEnumOption<v1::Culling>(
      command, "--cull", [&query](v1::Culling culling) { query.set_culling(culling); },
      "Side of the triangles to ignore [none]");
  command
      .add_option_function<float>(
          "--t-min", [&query](const float& t) { query.set_t_min(t); },
          "Start of the interval of t, inclusive, for rays without one of their own; the exact "
          "t of a hit counts, of which the one printed is rounded [0]")
      ->check(NotNan);
  command
      .add_option_function<float>(
          "--t-max", [&query](const float& t) { query.set_t_max(t); },
          "End of the interval of t, inclusive, likewise [inf]")
      ->check(NotNan);
}

absl::Status CheckInterval(const v1::RayQuery& query) {
  const bool own = query.layout() == v1::RAY_LAYOUT_FLOAT32X8 || query.layout() == v1::RAY_LAYOUT_FLOAT64X8;
  if (!own || (!query.has_t_min() && !query.has_t_max())) return absl::OkStatus();
  return UsageError("--t-min and --t-max are for rays without t_min and t_max of their own");
}

void AddRaysFormatFlag(CLI::App& command, std::optional<v1::RayLayout>& layout) {
  AddNamedOption<std::optional<v1::RayLayout>>(
      command, "--rays-format",
      {{"csv", std::nullopt},
       {"f32x6", v1::RAY_LAYOUT_FLOAT32X6},
       {"f32x8", v1::RAY_LAYOUT_FLOAT32X8},
       {"f64x6", v1::RAY_LAYOUT_FLOAT64X6},
       {"f64x8", v1::RAY_LAYOUT_FLOAT64X8}},
      [&layout](std::optional<v1::RayLayout> value) { layout = value; },
      "CSV, or raw little-endian arrays of 6 or 8 numbers a ray [csv]");
}

void AddQueryFlags(CLI::App& command, v1::RayQuery& query, size_t& batch_rays) {
  AddEnumOption<v1::AccuracyLevel>(
      command, "--accuracy", [&query](v1::AccuracyLevel level) { query.set_accuracy(level); },
      "Least accuracy to answer with [exact]");
  AddRayFlags(command, query);
  command.add_flag_callback(
      "--wait-final", [&query] { query.set_wait(v1::BUILD_WAIT_FINAL); },
      "Wait for the final tree instead of being answered while it is built; the answers are the same");
  command.add_option("--batch", batch_rays, "Rays a batch")
      ->check(CLI::Range(size_t{1}, kMaxStreamedBatchRays))
      ->type_name("N")
      ->capture_default_str();
}

}  // namespace deltaray
