// The process, by the names that Prometheus has for every process.

#ifndef SERVER_SERVICE_PROCESS_METRICS_H_
#define SERVER_SERVICE_PROCESS_METRICS_H_

#include <vector>

#include "prometheus/collectable.h"

namespace deltaray {

// Asks the system whenever it is read. Thread-safe.
class ProcessMetrics final : public prometheus::Collectable {
 public:
  std::vector<prometheus::MetricFamily> Collect() const override;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_PROCESS_METRICS_H_
