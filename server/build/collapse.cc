#include "server/build/collapse.h"

#include <algorithm>

namespace deltaray {

CollapsedTree::CollapsedTree(std::span<const Reference> references, const Dendrogram& dendrogram, const SahCosts& costs,
                             uint32_t max_leaf_size)
    : references_(references) {
  nodes_.reserve(references.size() + dendrogram.size());
  for (const Reference& reference : references) {
    nodes_.push_back({.bounds = reference.bounds, .cost = costs.Leaf(reference.bounds.HalfArea(), 1)});
  }
  for (const auto& [left_id, right_id] : dendrogram) {
    const Node& left = nodes_[left_id];
    const Node& right = nodes_[right_id];
    Node node{.bounds = Union(left.bounds, right.bounds),
              .left = left_id,
              .right = right_id,
              .count = left.count + right.count,
              .depth = std::max(left.depth, right.depth) + 1,
              .is_leaf = false};
    const double half_area = node.bounds.HalfArea();
    node.cost = costs.traversal * half_area + left.cost + right.cost;
    const double leaf_cost = costs.Leaf(half_area, node.count);
    if (node.count <= max_leaf_size && leaf_cost <= node.cost) {
      node.cost = leaf_cost;
      node.depth = 0;
      node.is_leaf = true;
    }
    nodes_.push_back(node);
  }
}

BvhArrays CollapsedTree::ToBvhArrays() const {
  BvhArrays arrays;
  arrays.nodes.reserve(nodes_.size());
  arrays.references.reserve(references_.size());
  // Depth first; a second child tells its parent where it is.
  struct Visit {
    uint32_t cluster;
    uint32_t parent;  // of a second child, or kFirstChild
  };
  constexpr uint32_t kFirstChild = 0xFFFFFFFF;
  std::vector<Visit> to_visit{{static_cast<uint32_t>(nodes_.size() - 1), kFirstChild}};
  std::vector<uint32_t> in_leaf;
  while (!to_visit.empty()) {
    const auto [cluster, parent] = to_visit.back();
    to_visit.pop_back();
    const Node& node = nodes_[cluster];
    const uint32_t index = static_cast<uint32_t>(arrays.nodes.size());
    if (parent != kFirstChild) arrays.nodes[parent].offset = index;
    if (!node.is_leaf) {
      arrays.nodes.push_back({node.bounds, 0, 0});
      to_visit.push_back({node.right, index});
      to_visit.push_back({node.left, kFirstChild});
      continue;
    }
    arrays.nodes.push_back({node.bounds, static_cast<uint32_t>(arrays.references.size()), node.count});
    in_leaf.push_back(cluster);
    while (!in_leaf.empty()) {
      const uint32_t below = in_leaf.back();
      in_leaf.pop_back();
      if (below < references_.size()) {
        arrays.references.push_back(references_[below].primitive);
      } else {
        in_leaf.push_back(nodes_[below].right);
        in_leaf.push_back(nodes_[below].left);
      }
    }
  }
  return arrays;
}

}  // namespace deltaray
