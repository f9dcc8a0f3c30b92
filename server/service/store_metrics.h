// What the store holds, as Prometheus reads it.

#ifndef SERVER_SERVICE_STORE_METRICS_H_
#define SERVER_SERVICE_STORE_METRICS_H_

#include <vector>

#include "prometheus/collectable.h"
#include "server/service/metrics.h"
#include "server/store/mesh_store.h"

namespace deltaray {

// Asks the store whenever it is read. Thread-safe.
class StoreMetrics final : public prometheus::Collectable {
 public:
  // Both outlive this.
  StoreMetrics(Metrics* metrics, const MeshStore* store) : metrics_(metrics), store_(store) {}

  // Also takes away the series of deleted meshes from `metrics`.
  std::vector<prometheus::MetricFamily> Collect() const override;

 private:
  Metrics* const metrics_;
  const MeshStore* const store_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_STORE_METRICS_H_
