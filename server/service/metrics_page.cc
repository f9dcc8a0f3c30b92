#include "server/service/metrics_page.h"

#include <exception>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "prometheus/exposer.h"
#include "server/service/batch_metrics.h"
#include "server/service/connection_metrics.h"
#include "server/service/process_metrics.h"
#include "server/service/store_metrics.h"

namespace deltaray {
namespace {

class ExposedPage final : public MetricsPage {
 public:
  ExposedPage(const std::string& address, Metrics* metrics, const MeshStore* store, const BatchBudget* budget,
              const Listener* listener)
      // Whoever opens connections and says nothing holds one of two threads for so long.
      : exposer_({"listening_ports", address, "num_threads", "2", "request_timeout_ms", "5000"}),
        store_(std::make_shared<StoreMetrics>(metrics, store)),
        batches_(std::make_shared<BatchMetrics>(budget)),
        connections_(std::make_shared<ConnectionMetrics>(listener)),
        process_(std::make_shared<ProcessMetrics>()) {
    exposer_.RegisterCollectable(store_);
    exposer_.RegisterCollectable(batches_);
    exposer_.RegisterCollectable(connections_);
    exposer_.RegisterCollectable(metrics->registry());
    exposer_.RegisterCollectable(process_);
  }

  int port() const override { return exposer_.GetListeningPorts().at(0); }

 private:
  prometheus::Exposer exposer_;
  const std::shared_ptr<StoreMetrics> store_;
  const std::shared_ptr<BatchMetrics> batches_;
  const std::shared_ptr<ConnectionMetrics> connections_;
  const std::shared_ptr<ProcessMetrics> process_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<MetricsPage>> MetricsPage::Serve(const std::string& address, Metrics* metrics,
                                                                const MeshStore* store, const BatchBudget* budget,
                                                                const Listener* listener) {
  try {
    return std::make_unique<ExposedPage>(address, metrics, store, budget, listener);
  } catch (const std::exception&) {
    return absl::UnavailableError(absl::StrCat("cannot listen for metrics at ", address,
                                               ": the address is malformed, not of this machine, or taken"));
  }
}

}  // namespace deltaray
