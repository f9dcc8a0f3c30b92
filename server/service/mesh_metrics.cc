#include "server/service/mesh_metrics.h"

#include <vector>

namespace deltaray {
namespace {

prometheus::Family<prometheus::Counter>& AddFamily(prometheus::Registry& registry, const char* name, const char* help) {
  return prometheus::BuildCounter().Name(name).Help(help).Register(registry);
}

}  // namespace

MeshMetrics::MeshMetrics(prometheus::Registry& registry)
    : batches_(AddFamily(registry, "deltaray_mesh_batches_total", "Batches answered, of each mesh.")),
      rays_(AddFamily(registry, "deltaray_mesh_rays_total", "Rays answered, of each mesh.")),
      hits_(AddFamily(registry, "deltaray_mesh_hits_total", "Hits found, of each mesh.")),
      other_(Add("other")) {}

MeshMetrics::Series MeshMetrics::Add(const std::string& label) {
  const prometheus::Labels labels{{"mesh", label}};
  return {&batches_.Add(labels), &rays_.Add(labels), &hits_.Add(labels)};
}

void MeshMetrics::CountBatch(std::string_view id, uint64_t rays, uint64_t hits) {
  MutexLock lock(mutex_);
  auto mesh = meshes_.find(id);
  if (mesh == meshes_.end() && meshes_.size() < kMaxMeshes) {
    mesh = meshes_.emplace(id, Add(std::string(id))).first;
  }
  const Series& series = mesh == meshes_.end() ? other_ : mesh->second;
  series.batches->Increment();
  series.rays->Increment(static_cast<double>(rays));
  series.hits->Increment(static_cast<double>(hits));
}

void MeshMetrics::Prune(const std::function<bool(const std::string& id)>& exists) {
  std::vector<std::string> ids;
  {
    MutexLock lock(mutex_);
    for (const auto& [id, series] : meshes_) ids.push_back(id);
  }
  for (const std::string& id : ids) {
    if (exists(id)) continue;
    MutexLock lock(mutex_);
    const auto mesh = meshes_.find(id);
    if (mesh == meshes_.end()) continue;
    batches_.Remove(mesh->second.batches);
    rays_.Remove(mesh->second.rays);
    hits_.Remove(mesh->second.hits);
    meshes_.erase(mesh);
  }
}

}  // namespace deltaray
