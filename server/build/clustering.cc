#include "server/build/clustering.h"

#include <algorithm>
#include <limits>

namespace deltaray {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

double Greater(double a, double b) { return a > b ? a : b; }
double Less(double a, double b) { return a < b ? a : b; }

// The clusters that are left, as arrays, so that the cost of one with all others is found in vector registers.
class Clusters {
 public:
  Clusters(std::span<const Reference> references, const ClusteringCost& cost)
      : area_weight_(cost.area_weight()), distance_weight_(cost.distance_weight()), size_(references.size()) {
    for (std::vector<double>* const column : {&min_x_, &min_y_, &min_z_, &max_x_, &max_y_, &max_z_, &count_, &costs_}) {
      column->resize(size_);
    }
    for (size_t i = 0; i < size_; ++i) {
      const Bounds& b = references[i].bounds;
      min_x_[i] = b.min.x, min_y_[i] = b.min.y, min_z_[i] = b.min.z;
      max_x_[i] = b.max.x, max_y_[i] = b.max.y, max_z_[i] = b.max.z;
      count_[i] = 1;
    }
  }

  size_t size() const { return size_; }

  // Makes `into` the union of both and moves the last cluster to the place of `from`.
  void Merge(size_t into, size_t from) {
    min_x_[into] = Less(min_x_[into], min_x_[from]), max_x_[into] = Greater(max_x_[into], max_x_[from]);
    min_y_[into] = Less(min_y_[into], min_y_[from]), max_y_[into] = Greater(max_y_[into], max_y_[from]);
    min_z_[into] = Less(min_z_[into], min_z_[from]), max_z_[into] = Greater(max_z_[into], max_z_[from]);
    count_[into] += count_[from];
    --size_;
    for (std::vector<double>* const column : {&min_x_, &min_y_, &min_z_, &max_x_, &max_y_, &max_z_, &count_}) {
      (*column)[from] = (*column)[size_];
    }
  }

  // The cost of merging cluster i with each; infinite with itself. Valid until the next call.
  const std::vector<double>& CostsOf(size_t i) {
    const double min_x = min_x_[i], min_y = min_y_[i], min_z = min_z_[i];
    const double max_x = max_x_[i], max_y = max_y_[i], max_z = max_z_[i];
    const double count = count_[i];
    for (size_t k = 0; k < size_; ++k) {
      const double x = Greater(max_x_[k], max_x) - Less(min_x_[k], min_x);
      const double y = Greater(max_y_[k], max_y) - Less(min_y_[k], min_y);
      const double z = Greater(max_z_[k], max_z) - Less(min_z_[k], min_z);
      const double gap_x = Greater(0, Greater(min_x_[k], min_x) - Less(max_x_[k], max_x));
      const double gap_y = Greater(0, Greater(min_y_[k], min_y) - Less(max_y_[k], max_y));
      const double gap_z = Greater(0, Greater(min_z_[k], min_z) - Less(max_z_[k], max_z));
      costs_[k] = area_weight_ * (x * y + y * z + z * x) * (count_[k] + count) +
                  distance_weight_ * (gap_x * gap_x + gap_y * gap_y + gap_z * gap_z);
    }
    costs_[i] = kInfinity;
    return costs_;
  }

 private:
  const double area_weight_;
  const double distance_weight_;
  size_t size_;
  std::vector<double> min_x_, min_y_, min_z_, max_x_, max_y_, max_z_, count_, costs_;
};

}  // namespace

ClusteringCost::ClusteringCost(double alpha, const Config& config, const Bounds& all, double distance_unit)
    : area_weight_(all.HalfArea() > 0 ? alpha * config.cluster_intersection_cost / all.HalfArea() : 0),
      distance_weight_(distance_unit > 0 ? (1 - alpha) / (distance_unit * distance_unit) : 0) {}

Dendrogram Cluster(std::span<const Reference> references, const ClusteringCost& cost, const BuildContext& context) {
  constexpr size_t kUnknown = std::numeric_limits<size_t>::max();
  const size_t count = references.size();
  Clusters clusters(references, cost);
  std::vector<uint32_t> ids(count);            // of clusters in the dendrogram
  std::vector<size_t> nearest(count);          // kUnknown: it was merged
  std::vector<double> nearest_cost(count, 0);  // a lower bound where nearest is unknown
  const auto find_nearest = [&](size_t i) {
    const std::vector<double>& costs = clusters.CostsOf(i);
    nearest[i] = std::min_element(costs.begin(), costs.begin() + clusters.size()) - costs.begin();
    nearest_cost[i] = costs[nearest[i]];
  };
  for (size_t i = 0; i < count; ++i) {
    ids[i] = static_cast<uint32_t>(i);
    find_nearest(i);
  }

  Dendrogram dendrogram;
  dendrogram.reserve(count - 1);
  while (clusters.size() > 1 && !context.cancelled()) {
    // Find the cheapest pair.
    size_t a;
    while (true) {
      a = std::min_element(nearest_cost.begin(), nearest_cost.begin() + clusters.size()) - nearest_cost.begin();
      if (nearest[a] != kUnknown) break;
      find_nearest(a);
    }

    // Merge it.
    const size_t into = std::min(a, nearest[a]), from = std::max(a, nearest[a]), last = clusters.size() - 1;
    dendrogram.push_back({ids[into], ids[from]});
    clusters.Merge(into, from);
    ids[into] = static_cast<uint32_t>(count + dendrogram.size() - 1);
    ids[from] = ids[last];
    nearest[from] = nearest[last];
    nearest_cost[from] = nearest_cost[last];

    // Let the others know.
    const std::vector<double>& costs = clusters.CostsOf(into);
    nearest[into] = kUnknown;
    nearest_cost[into] = kInfinity;
    for (size_t k = 0; k < last; ++k) {
      if (k == into) continue;
      if (nearest[k] == into || nearest[k] == from) {
        nearest[k] = kUnknown;
      } else if (nearest[k] == last) {
        nearest[k] = from;
      }
      if (costs[k] < nearest_cost[k] || (costs[k] == nearest_cost[k] && nearest[k] == kUnknown)) {
        nearest[k] = into;
        nearest_cost[k] = costs[k];
      }
      if (costs[k] < nearest_cost[into]) {
        nearest[into] = k;
        nearest_cost[into] = costs[k];
      }
    }
  }
  return dendrogram;
}

}  // namespace deltaray
