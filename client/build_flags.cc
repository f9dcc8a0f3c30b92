#include "client/build_flags.h"

#include "client/enum_names.h"

namespace deltaray {

void AddBuildFlags(CLI::App& command, const std::function<v1::BuildOptions&()>& options) {
  const char* const group = "How to build the tree";
  AddEnumOption<v1::BuildPreset>(
      command, "--preset", [options](v1::BuildPreset preset) { options().set_preset(preset); },
      "Build time against traversal speed [balanced]")
      ->group(group);
  AddEnumOption<v1::TreeBuilder>(
      command, "--builder", [options](v1::TreeBuilder builder) { options().set_builder(builder); },
      "Structure to build [hybrid]")
      ->group(group);
  command
      .add_option_function<uint32_t>(
          "--delta", [options](const uint32_t& delta) { options().set_delta(delta); },
          "Most references in a delta-leaf, 1 to 4096 [32]")
      ->group(group);
  command
      .add_option_function<double>(
          "--alpha", [options](const double& alpha) { options().set_alpha(alpha); },
          "Weight of area against distance in the clustering cost, 0 to 1 [0.6]")
      ->group(group);
  command
      .add_option_function<double>(
          "--traversal-cost", [options](const double& cost) { options().set_traversal_cost(cost); },
          "Cost of a traversal step [by builder]")
      ->group(group);
  command
      .add_option_function<double>(
          "--intersection-cost", [options](const double& cost) { options().set_intersection_cost(cost); },
          "Cost of a ray-triangle intersection [by builder]")
      ->group(group);
  command
      .add_flag_function(
          "--lazy", [options](int64_t times) { options().set_lazy(times > 0); },
          "Build a delta-leaf when the first ray reaches it")
      ->group(group);
}

}  // namespace deltaray
