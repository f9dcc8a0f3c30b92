// Where Prometheus fetches the metrics.

#ifndef SERVER_SERVICE_METRICS_PAGE_H_
#define SERVER_SERVICE_METRICS_PAGE_H_

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/service/batch_budget.h"
#include "server/service/listener.h"
#include "server/service/metrics.h"
#include "server/store/mesh_store.h"

namespace deltaray {

// An HTTP server of its own, which answers GET /metrics: the counters of `metrics`, what the store, batches
// and connections hold, and the process. Works while gRPC does not.
class MetricsPage {
 public:
  // Listens at `address`, host:port. UNAVAILABLE where that cannot be had. All outlive the page.
  static absl::StatusOr<std::unique_ptr<MetricsPage>> Serve(const std::string& address, Metrics* metrics,
                                                            const MeshStore* store, const BatchBudget* budget,
                                                            const Listener* listener);

  virtual ~MetricsPage() = default;
  virtual int port() const = 0;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_METRICS_PAGE_H_
