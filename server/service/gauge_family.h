// Metrics that are asked for, not counted.

#ifndef SERVER_SERVICE_GAUGE_FAMILY_H_
#define SERVER_SERVICE_GAUGE_FAMILY_H_

#include <string>
#include <utility>
#include <vector>

#include "prometheus/metric_family.h"

namespace deltaray {

// A family of gauges as Prometheus reads it, of values by the label `label`; with an empty `label`, of one value.
inline prometheus::MetricFamily GaugeFamily(std::string name, std::string help, const std::string& label,
                                            const std::vector<std::pair<std::string, double>>& values) {
  prometheus::MetricFamily family{std::move(name), std::move(help), prometheus::MetricType::Gauge, {}};
  for (const auto& [value_label, value] : values) {
    prometheus::ClientMetric metric;
    if (!label.empty()) metric.label.push_back({label, value_label});
    metric.gauge.value = value;
    family.metric.push_back(std::move(metric));
  }
  return family;
}

inline prometheus::MetricFamily GaugeFamily(std::string name, std::string help, double value) {
  return GaugeFamily(std::move(name), std::move(help), "", {{"", value}});
}

}  // namespace deltaray

#endif  // SERVER_SERVICE_GAUGE_FAMILY_H_
