// The connections, as Prometheus reads them.

#ifndef SERVER_SERVICE_CONNECTION_METRICS_H_
#define SERVER_SERVICE_CONNECTION_METRICS_H_

#include <vector>

#include "prometheus/collectable.h"
#include "server/service/gauge_family.h"
#include "server/service/listener.h"

namespace deltaray {

// Asks the listener whenever it is read. Thread-safe.
class ConnectionMetrics final : public prometheus::Collectable {
 public:
  // The listener outlives this.
  explicit ConnectionMetrics(const Listener* listener) : listener_(listener) {}

  std::vector<prometheus::MetricFamily> Collect() const override {
    prometheus::MetricFamily refused{"deltaray_connections_refused_total",
                                     "Connections that were closed at once, at the limit.",
                                     prometheus::MetricType::Counter,
                                     {{}}};
    refused.metric[0].counter.value = static_cast<double>(listener_->refused());
    return {GaugeFamily("deltaray_connections", "Open connections.", static_cast<double>(listener_->connections())),
            GaugeFamily("deltaray_connections_limit",
                        "--max-connections, or less where there are not as many file descriptors.",
                        static_cast<double>(listener_->max_connections())),
            refused};
  }

 private:
  const Listener* const listener_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_CONNECTION_METRICS_H_
