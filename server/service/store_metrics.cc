#include "server/service/store_metrics.h"

#include <string>
#include <utility>

#include "server/service/gauge_family.h"

namespace deltaray {
namespace {
constexpr const char* kStateNames[] = {"stored", "building", "provisional", "ready", "failed"};
}  // namespace

std::vector<prometheus::MetricFamily> StoreMetrics::Collect() const {
  metrics_->meshes().Prune([this](const std::string& id) { return store_->Resolve(id).ok(); });

  const StoreUsage usage = store_->Usage();
  std::vector<std::pair<std::string, double>> states;
  for (size_t i = 0; i < usage.meshes.size(); ++i) {
    states.emplace_back(kStateNames[i], static_cast<double>(usage.meshes[i]));
  }
  return {GaugeFamily("deltaray_meshes", "Meshes by state.", "state", states),
          GaugeFamily("deltaray_disk_bytes", "Bytes of all meshes on disk.", static_cast<double>(usage.disk_bytes)),
          GaugeFamily("deltaray_data_directory_writable", "Whether the data directory can be written to.",
                      usage.directory_writable ? 1 : 0),
          GaugeFamily(
              "deltaray_memory_bytes", "Bytes in memory of geometry, and of trees that are built.", "what",
              {{"meshes", static_cast<double>(usage.mesh_bytes)}, {"trees", static_cast<double>(usage.tree_bytes)}}),
          GaugeFamily("deltaray_budget_bytes", "What counts towards --tree-bytes, builds and uploads included.",
                      static_cast<double>(usage.budget_bytes)),
          GaugeFamily("deltaray_budget_limit_bytes", "--tree-bytes.", static_cast<double>(usage.budget_limit)),
          GaugeFamily("deltaray_builds_waiting", "Builds that wait for their turn.",
                      static_cast<double>(usage.builds_waiting)),
          GaugeFamily("deltaray_builds_under_way", "Builds that run.", static_cast<double>(usage.builds_running))};
}

}  // namespace deltaray
