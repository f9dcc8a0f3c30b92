#include "server/build/clustering.h"

#include <algorithm>
#include <cstddef>
#include <limits>

#include "server/build/sah.h"

// Compiled once for each kind of vector registers; HWY_NAMESPACE is another each time.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "server/build/clustering.cc"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "server/build/vector_columns.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr int32_t kUnknown = -1;

// The clusters that are left, as columns, so that the cost of one with all others is found in vector registers. Boxes
// are scaled to the unit cube, where float is enough to choose by.
class Clusters {
 public:
  Clusters(std::span<const Reference> references, const ClusteringCost& cost)
      : size_(references.size()), group_size_(static_cast<float>(cost.group_size())), columns_(size_), nearest_(size_) {
    Bounds all;
    for (const Reference& reference : references) all.Extend(reference.bounds);
    const double scale = UnitScale(all);
    // Areas and squared distances are scaled alike, so that only the ratio of their weights counts.
    const double greatest = std::max(cost.area_weight(), cost.distance_weight());
    area_weight_ = greatest > 0 ? static_cast<float>(cost.area_weight() / greatest) : 0;
    distance_weight_ = greatest > 0 ? static_cast<float>(cost.distance_weight() / greatest) : 0;
    for (size_t i = 0; i < size_; ++i) {
      const Bounds& bounds = references[i].bounds;
      for (int axis = 0; axis < 3; ++axis) {
        const double first = all.min[axis];
        columns_[kMin + axis][i] = static_cast<float>((bounds.min[axis] - first) * scale);
        columns_[kMax + axis][i] = static_cast<float>((bounds.max[axis] - first) * scale);
      }
      columns_[kCount][i] = 1;
      columns_[kBlocked][i] = 0;
    }
    for (size_t i = size_; i < columns_.padded_size(); ++i) {
      for (int column = kMin; column <= kCount; ++column) columns_[column][i] = 0;
      columns_[kBlocked][i] = columns_[kNearestCost][i] = kInfinity;
    }
    for (size_t i = 0; i < size_; ++i) FindNearest(i);
  }

  size_t size() const { return size_; }

  // A cluster of the cheapest pair that is left, and the other one.
  HWY_ATTR std::pair<size_t, size_t> CheapestPair() {
    while (true) {
      const size_t i = IndexOfLeast(columns_[kNearestCost]);
      if (nearest_[0][i] != kUnknown) return {i, static_cast<size_t>(nearest_[0][i])};
      FindNearest(i);
    }
  }

  // Makes `into` the union of both and moves the last cluster to the place of `from`. REQUIRES: into < from.
  HWY_ATTR void Merge(size_t into, size_t from) {
    const size_t last = --size_;
    for (int axis = 0; axis < 3; ++axis) {
      float* const min = columns_[kMin + axis];
      float* const max = columns_[kMax + axis];
      min[into] = std::min(min[into], min[from]);
      max[into] = std::max(max[into], max[from]);
    }
    columns_[kCount][into] += columns_[kCount][from];
    for (int column = 0; column < kColumns; ++column) columns_[column][from] = columns_[column][last];
    nearest_[0][from] = nearest_[0][last];
    columns_[kBlocked][last] = columns_[kNearestCost][last] = kInfinity;
    TellOthers(into, from, last);
  }

 private:
  enum Column { kMin = 0, kMax = 3, kCount = 6, kBlocked, kNearestCost, kCosts, kColumns };
  using Floats = hn::ScalableTag<float>;
  using Ints = hn::RebindToSigned<Floats>;

  // Fills the costs of merging cluster i with each; infinite with itself and with what there is not.
  HWY_ATTR void FindCosts(size_t i) {
    const Floats d;
    columns_[kBlocked][i] = kInfinity;
    const auto min_x = hn::Set(d, columns_[kMin][i]), max_x = hn::Set(d, columns_[kMax][i]);
    const auto min_y = hn::Set(d, columns_[kMin + 1][i]), max_y = hn::Set(d, columns_[kMax + 1][i]);
    const auto min_z = hn::Set(d, columns_[kMin + 2][i]), max_z = hn::Set(d, columns_[kMax + 2][i]);
    const auto count = hn::Set(d, columns_[kCount][i]);
    const auto area_weight = hn::Set(d, area_weight_), distance_weight = hn::Set(d, distance_weight_);
    const auto group = hn::Set(d, group_size_), per_group = hn::Set(d, 1 / group_size_);
    const auto zero = hn::Zero(d);
    for (size_t k = 0; k < size_; k += hn::Lanes(d)) {
      const auto load = [&](int column) HWY_ATTR { return hn::Load(d, columns_[column] + k); };
      const auto k_min_x = load(kMin), k_max_x = load(kMax);
      const auto k_min_y = load(kMin + 1), k_max_y = load(kMax + 1);
      const auto k_min_z = load(kMin + 2), k_max_z = load(kMax + 2);
      const auto x = hn::Sub(hn::Max(k_max_x, max_x), hn::Min(k_min_x, min_x));
      const auto y = hn::Sub(hn::Max(k_max_y, max_y), hn::Min(k_min_y, min_y));
      const auto z = hn::Sub(hn::Max(k_max_z, max_z), hn::Min(k_min_z, min_z));
      const auto area = hn::Add(hn::Mul(x, hn::Add(y, z)), hn::Mul(y, z));
      const auto gap_x = hn::Max(zero, hn::Sub(hn::Max(k_min_x, min_x), hn::Min(k_max_x, max_x)));
      const auto gap_y = hn::Max(zero, hn::Sub(hn::Max(k_min_y, min_y), hn::Min(k_max_y, max_y)));
      const auto gap_z = hn::Max(zero, hn::Sub(hn::Max(k_min_z, min_z), hn::Min(k_max_z, max_z)));
      const auto distance = hn::Add(hn::Add(hn::Mul(gap_x, gap_x), hn::Mul(gap_y, gap_y)), hn::Mul(gap_z, gap_z));
      // References, groups counted as full ones.
      const auto work = hn::Mul(group, hn::Ceil(hn::Mul(per_group, hn::Add(load(kCount), count))));
      const auto area_cost = hn::Mul(hn::Mul(area_weight, area), work);
      const auto cost = hn::Add(area_cost, hn::Mul(distance_weight, distance));
      hn::Store(hn::Add(cost, load(kBlocked)), d, columns_[kCosts] + k);
    }
    columns_[kBlocked][i] = 0;
  }

  HWY_ATTR void FindNearest(size_t i) {
    FindCosts(i);
    const size_t nearest = IndexOfLeast(columns_[kCosts]);
    nearest_[0][i] = static_cast<int32_t>(nearest);
    columns_[kNearestCost][i] = columns_[kCosts][nearest];
  }

  // The first one of the least among the first size_ values and infinities.
  HWY_ATTR size_t IndexOfLeast(const float* values) const {
    const Floats d;
    auto least = hn::Load(d, values);
    for (size_t k = hn::Lanes(d); k < size_; k += hn::Lanes(d)) least = hn::Min(least, hn::Load(d, values + k));
    least = hn::MinOfLanes(d, least);
    for (size_t k = 0;; k += hn::Lanes(d)) {
      const intptr_t lane = hn::FindFirstTrue(d, hn::Eq(hn::Load(d, values + k), least));
      if (lane >= 0) return k + static_cast<size_t>(lane);
    }
  }

  // `into` was merged with `from`, in whose place the one from `last` stands now.
  HWY_ATTR void TellOthers(size_t into, size_t from, size_t last) {
    const Floats d;
    const Ints di;
    FindCosts(into);
    const auto into_id = hn::Set(di, static_cast<int32_t>(into)), from_id = hn::Set(di, static_cast<int32_t>(from));
    const auto last_id = hn::Set(di, static_cast<int32_t>(last)), unknown = hn::Set(di, kUnknown);
    for (size_t k = 0; k < size_; k += hn::Lanes(d)) {
      auto nearest = hn::Load(di, nearest_[0] + k);
      const auto merged = hn::Or(hn::Eq(nearest, into_id), hn::Eq(nearest, from_id));
      nearest = hn::IfThenElse(hn::Eq(nearest, last_id), from_id, nearest);
      nearest = hn::IfThenElse(merged, unknown, nearest);
      const auto cost = hn::Load(d, columns_[kCosts] + k), nearest_cost = hn::Load(d, columns_[kNearestCost] + k);
      const auto as_good = hn::And(hn::Eq(cost, nearest_cost), hn::RebindMask(d, hn::Eq(nearest, unknown)));
      const auto better = hn::Or(hn::Lt(cost, nearest_cost), as_good);
      hn::Store(hn::IfThenElse(hn::RebindMask(di, better), into_id, nearest), di, nearest_[0] + k);
      hn::Store(hn::Min(cost, nearest_cost), d, columns_[kNearestCost] + k);
    }
    const size_t nearest = IndexOfLeast(columns_[kCosts]);
    nearest_[0][into] = static_cast<int32_t>(nearest);
    columns_[kNearestCost][into] = columns_[kCosts][nearest];
  }

  size_t size_;
  const float group_size_;
  float area_weight_;
  float distance_weight_;
  VectorColumns<float, kColumns> columns_;
  VectorColumns<int32_t, 1> nearest_;  // kUnknown: it was merged, and its cost is a lower bound
};

Dendrogram ClusterReferences(std::span<const Reference> references, const ClusteringCost& cost,
                             const BuildContext& context) {
  const size_t count = references.size();
  Dendrogram dendrogram;
  dendrogram.reserve(count - 1);
  Clusters clusters(references, cost);
  VectorColumns<uint32_t, 1> ids(count);  // of clusters in the dendrogram
  for (size_t i = 0; i < count; ++i) ids[0][i] = static_cast<uint32_t>(i);
  while (clusters.size() > 1 && !context.cancelled()) {
    const auto [a, b] = clusters.CheapestPair();
    const size_t into = std::min(a, b), from = std::max(a, b);
    dendrogram.push_back({ids[0][into], ids[0][from]});
    clusters.Merge(into, from);
    ids[0][into] = static_cast<uint32_t>(count + dendrogram.size() - 1);
    ids[0][from] = ids[0][clusters.size()];
  }
  return dendrogram;
}

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace deltaray {

HWY_EXPORT(ClusterReferences);

ClusteringCost::ClusteringCost(double alpha, const Config& config, const Bounds& all, double distance_unit)
    : area_weight_(all.HalfArea() > 0 ? alpha * config.cluster_intersection_cost / all.HalfArea() : 0),
      distance_weight_(distance_unit > 0 ? (1 - alpha) / (distance_unit * distance_unit) : 0),
      group_size_(1u << SahCosts(config).group_shift) {}

Dendrogram Cluster(std::span<const Reference> references, const ClusteringCost& cost, const BuildContext& context) {
  return HWY_DYNAMIC_DISPATCH(ClusterReferences)(references, cost, context);
}

}  // namespace deltaray
#endif  // HWY_ONCE
