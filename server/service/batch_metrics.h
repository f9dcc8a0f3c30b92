// The memory that batches take, as Prometheus reads it.

#ifndef SERVER_SERVICE_BATCH_METRICS_H_
#define SERVER_SERVICE_BATCH_METRICS_H_

#include <vector>

#include "prometheus/collectable.h"
#include "server/service/batch_budget.h"
#include "server/service/gauge_family.h"

namespace deltaray {

// Asks the budget whenever it is read. Thread-safe.
class BatchMetrics final : public prometheus::Collectable {
 public:
  // The budget outlives this.
  explicit BatchMetrics(const BatchBudget* budget) : budget_(budget) {}

  std::vector<prometheus::MetricFamily> Collect() const override {
    return {GaugeFamily("deltaray_batch_bytes", "Bytes of all batches on their way, what is kept for them included.",
                        static_cast<double>(budget_->used())),
            GaugeFamily("deltaray_batch_limit_bytes", "--batch-bytes.", static_cast<double>(budget_->limit()))};
  }

 private:
  const BatchBudget* const budget_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_BATCH_METRICS_H_
