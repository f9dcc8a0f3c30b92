#include "client/query_flags.h"

#include "client/enum_names.h"

namespace deltaray {
namespace {

// The contract's limit.
constexpr size_t kMaxBatchRays = 1 << 20;

}  // namespace

void AddQueryFlags(CLI::App& command, v1::RayQuery& query, size_t& batch_rays) {
  AddEnumOption<v1::AccuracyLevel>(
      command, "--accuracy", [&query](v1::AccuracyLevel level) { query.set_accuracy(level); },
      "Least accuracy to answer with [exact]");
  AddEnumOption<v1::Culling>(
      command, "--cull", [&query](v1::Culling culling) { query.set_culling(culling); },
      "Side of the triangles to ignore [none]");
  command.add_option_function<float>(
      "--t-min", [&query](const float& t) { query.set_t_min(t); },
      "Start of the interval of t, inclusive, for rays without one of their own [0]");
  command.add_option_function<float>(
      "--t-max", [&query](const float& t) { query.set_t_max(t); },
      "End of the interval of t, inclusive, for rays without one of their own [inf]");
  command.add_flag_callback(
      "--wait-final", [&query] { query.set_wait(v1::BUILD_WAIT_FINAL); },
      "Wait for the final tree instead of being answered while it is built; the answers are the same");
  command.add_option("--batch", batch_rays, "Rays a batch")
      ->check(CLI::Range(size_t{1}, kMaxBatchRays))
      ->type_name("N")
      ->capture_default_str();
}

}  // namespace deltaray
