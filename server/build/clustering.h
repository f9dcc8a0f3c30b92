// Agglomerative clustering of a δ-leaf's references. [Tang 2015], section 3.2 and table 2.

#ifndef SERVER_BUILD_CLUSTERING_H_
#define SERVER_BUILD_CLUSTERING_H_

#include <cstdint>
#include <span>
#include <vector>

#include "server/build/build_context.h"
#include "server/build/config.h"
#include "server/build/reference.h"
#include "server/geometry/bounds.h"

namespace deltaray {

// A binary tree over n references down to single ones, as the n - 1 merges that make it from them. Cluster i < n is
// reference i; cluster n + k is what merge k made. Every cluster but the last is merged once, after it was made.
struct Merge {
  uint32_t left = 0, right = 0;
};
using Dendrogram = std::vector<Merge>;

// The cost of merging clusters 1 and 2:
//
//     C = α · { Ct + SA(B1 ∪ B2) / SA(Ball) · (N1 + N2) · Ci } + (1 − α) · d²
//
// B: their boxes; N: their numbers of references; Ball: the box of the whole mesh; d: the distance between the boxes.
// α · Ct is left out, since it is the same for all pairs. α = 1: area only. α = 0: distance only. For the hybrid, whose
// leaves are tested in groups, N1 + N2 counts the last group as a full one (see SahCosts); printed it counts triangles.
class ClusteringCost {
 public:
  // Distances are divided by `distance_unit`: printed is 1, which makes the tree depend on the mesh's unit; the hybrid
  // takes the δ-leaf's diagonal. `all`: Ball.
  ClusteringCost(double alpha, const Config& config, const Bounds& all, double distance_unit);

  double area_weight() const { return area_weight_; }          // of half area times number of references
  double distance_weight() const { return distance_weight_; }  // of squared distance
  uint32_t group_size() const { return group_size_; }          // that references are counted in

 private:
  double area_weight_;
  double distance_weight_;
  uint32_t group_size_;
};

// Merges the pair of least cost, in float, until one cluster is left. Of pairs of the same cost, which one comes first
// is fixed by the order of `references`, so that the same input gives the same output, on any machine.
//
// Each cluster keeps a nearest neighbour and its cost. A merge can take a cluster's neighbour away, but makes none of
// its other pairs cheaper save that with the new cluster, which is looked at; so the kept cost still bounds it from
// below, and a new neighbour is looked for only once that bound is the least of all [Müllner 2011]. That takes O(n²)
// time in practice (the worst case is O(n³)) where table 2 as printed takes O(n³), and O(n) memory. Polls `context` at
// every merge and returns anything once it is cancelled. Uses the widest vector registers that the machine has.
Dendrogram Cluster(std::span<const Reference> references, const ClusteringCost& cost, const BuildContext& context);

}  // namespace deltaray

#endif  // SERVER_BUILD_CLUSTERING_H_
