#include "server/build/delta_leaf.h"

#include <optional>
#include <utility>

#include "server/build/clustering.h"
#include "server/build/collapse.h"
#include "server/build/sah.h"
#include "server/build/sweep_builder.h"
#include "server/build/top_down.h"

namespace deltaray {
namespace {

constexpr DeltaLeafCandidate kAll[] = {DeltaLeafCandidate::kCombinedCost, DeltaLeafCandidate::kAreaOnly,
                                       DeltaLeafCandidate::kDistanceOnly, DeltaLeafCandidate::kTopDown};
// The two that win nearly always.
constexpr DeltaLeafCandidate kBalancedOnes[] = {DeltaLeafCandidate::kCombinedCost, DeltaLeafCandidate::kTopDown};
constexpr DeltaLeafCandidate kFastOnes[] = {DeltaLeafCandidate::kTopDown};

std::span<const DeltaLeafCandidate> CandidatesOf(Preset preset) {
  switch (preset) {
    case Preset::kFast:
      return kFastOnes;
    case Preset::kBalanced:
    case Preset::kAuto:
      return kBalancedOnes;
    case Preset::kBest:
      break;
  }
  return kAll;
}

// All references in one leaf.
BvhArrays OneLeaf(std::span<const Reference> references) {
  BvhArrays arrays;
  Bounds bounds;
  for (const Reference& reference : references) {
    bounds.Extend(reference.bounds);
    arrays.references.push_back(reference.primitive);
  }
  arrays.nodes.push_back({bounds, 0, static_cast<uint32_t>(references.size())});
  return arrays;
}

Dendrogram BuildCandidate(DeltaLeafCandidate candidate, std::span<const Reference> references,
                          const Bounds& mesh_bounds, const Config& config, const BuildContext& context) {
  if (candidate == DeltaLeafCandidate::kTopDown) return SplitBySweeps(references, SahCosts(config), context);
  Bounds bounds;
  for (const Reference& reference : references) bounds.Extend(reference.bounds);
  const double diagonal = Length(static_cast<Vec3d>(bounds.max) - static_cast<Vec3d>(bounds.min));
  const double alpha = candidate == DeltaLeafCandidate::kAreaOnly       ? 1
                       : candidate == DeltaLeafCandidate::kDistanceOnly ? 0
                                                                        : config.alpha;
  return Cluster(references, ClusteringCost(alpha, config, mesh_bounds, diagonal), context);
}

}  // namespace

BvhArrays BuildDeltaLeaf(std::span<const Reference> references, const Bounds& mesh_bounds, const Config& config,
                         BuildContext& context) {
  // What fits in a leaf is one where the build must be fast: no tree is looked for in it.
  if (config.preset == Preset::kFast && references.size() <= config.max_leaf_size) return OneLeaf(references);
  const SahCosts costs(config);
  std::optional<Dendrogram> best;
  double best_cost = 0;
  DeltaLeafCandidate winner{};
  for (const DeltaLeafCandidate candidate : CandidatesOf(config.preset)) {
    Dendrogram dendrogram = BuildCandidate(candidate, references, mesh_bounds, config, context);
    if (context.cancelled()) return BvhArrays();
    const CollapsedTree tree(references, dendrogram, costs, config.max_leaf_size);
    // Clusters may nest in a chain; only splits are sure to keep the tree flat.
    if (tree.depth() > kSahDepth && candidate != DeltaLeafCandidate::kTopDown) continue;
    if (best && best_cost <= tree.cost()) continue;
    best = std::move(dendrogram);
    best_cost = tree.cost();
    winner = candidate;
  }
  context.candidate_wins[static_cast<size_t>(winner)].fetch_add(1, std::memory_order_relaxed);
  return CollapsedTree(references, *best, costs, 1).ToBvhArrays();
}

}  // namespace deltaray
