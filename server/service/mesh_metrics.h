// What is counted for each mesh, for a bounded number of them.

#ifndef SERVER_SERVICE_MESH_METRICS_H_
#define SERVER_SERVICE_MESH_METRICS_H_

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <string_view>

#include "prometheus/counter.h"
#include "prometheus/family.h"
#include "prometheus/registry.h"
#include "server/build/mutex.h"

namespace deltaray {

// Thread-safe.
class MeshMetrics {
 public:
  // The first so many meshes that are asked have series of their own, labelled by id; the others share "other". Clients
  // make meshes, and what Prometheus keeps must not grow with what clients do.
  static constexpr size_t kMaxMeshes = 100;

  // `registry` outlives this.
  explicit MeshMetrics(prometheus::Registry& registry);

  void CountBatch(std::string_view id, uint64_t rays, uint64_t hits);

  // Takes away the series of meshes that are no more, which makes room for others.
  void Prune(const std::function<bool(const std::string& id)>& exists);

 private:
  struct Series {
    prometheus::Counter* batches = nullptr;
    prometheus::Counter* rays = nullptr;
    prometheus::Counter* hits = nullptr;
  };

  Series Add(const std::string& label);

  prometheus::Family<prometheus::Counter>& batches_;
  prometheus::Family<prometheus::Counter>& rays_;
  prometheus::Family<prometheus::Counter>& hits_;
  const Series other_;
  // Also held while a series is counted in, so that it is not taken away meanwhile.
  Mutex mutex_;
  std::map<std::string, Series, std::less<>> meshes_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_MESH_METRICS_H_
