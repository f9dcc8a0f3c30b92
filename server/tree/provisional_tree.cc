#include "server/tree/provisional_tree.h"

#include <algorithm>
#include <utility>

#include "server/tree/bvh_traversal.h"

namespace deltaray {

ProvisionalTree::ProvisionalTree(TrianglesView triangles, BvhArrays top, ReachDeltaLeaf reach_delta_leaf)
    : TraversedTree(triangles),
      top_(std::move(top)),
      delta_leaf_of_node_(top_.nodes.size()),
      delta_leaves_(std::count_if(top_.nodes.begin(), top_.nodes.end(), [](const BvhNode& n) { return n.IsLeaf(); })),
      reach_delta_leaf_(std::move(reach_delta_leaf)) {
  uint32_t next = 0;
  for (size_t i = 0; i < top_.nodes.size(); ++i) {
    if (top_.nodes[i].IsLeaf()) delta_leaf_of_node_[i] = next++;
  }
}

ProvisionalTree::~ProvisionalTree() {
  for (const auto& subtree : delta_leaves_) delete subtree.load(std::memory_order_acquire);
}

uint32_t ProvisionalTree::delta_leaf_count() const { return static_cast<uint32_t>(delta_leaves_.size()); }

uint32_t ProvisionalTree::delta_leaves_built() const { return built_.load(std::memory_order_acquire); }

void ProvisionalTree::PublishDeltaLeaf(uint32_t delta_leaf, std::unique_ptr<const BvhArrays> subtree) {
  // Release: a thread that sees the pointer sees the subtree.
  delta_leaves_[delta_leaf].store(subtree.release(), std::memory_order_release);
  built_.fetch_add(1, std::memory_order_release);
}

const BvhArrays* ProvisionalTree::delta_leaf(uint32_t delta_leaf) const {
  return delta_leaves_[delta_leaf].load(std::memory_order_acquire);
}

void ProvisionalTree::Traverse(const Ray& ray, Collector& collector) const {
  const BoxTest box_test(ray);
  TraverseBvh(top_.nodes, box_test, collector, [&](uint32_t leaf) {
    const uint32_t index = delta_leaf_of_node_[leaf];
    const BvhArrays* subtree = delta_leaf(index);
    if (subtree == nullptr && reach_delta_leaf_) {
      reach_delta_leaf_(index);
      subtree = delta_leaf(index);
    }
    if (subtree == nullptr) {
      collector.Visit(top_.LeafReferences(top_.nodes[leaf]));
      return;
    }
    TraverseBvh(subtree->nodes, box_test, collector,
                [&](uint32_t i) { collector.Visit(subtree->LeafReferences(subtree->nodes[i])); });
  });
}

TreeShape ProvisionalTree::Shape() const {
  TreeShape shape{.node_bytes = top_.nodes.size() * sizeof(BvhNode),
                  .reference_bytes = top_.references.size() * sizeof(uint32_t)};
  const double root_half_area = top_.nodes.empty() ? 0 : top_.nodes[0].bounds.HalfArea();
  ForEachNode(top_.nodes, 0, [&](uint32_t i, uint32_t depth) {
    const BvhArrays* subtree = top_.nodes[i].IsLeaf() ? delta_leaf(delta_leaf_of_node_[i]) : nullptr;
    if (subtree == nullptr) {
      AddNode(top_.nodes[i], depth, root_half_area, &shape);
      return;
    }
    // The subtree stands in for the δ-leaf's node.
    ForEachNode(subtree->nodes, depth, [&](uint32_t j, uint32_t subtree_depth) {
      AddNode(subtree->nodes[j], subtree_depth, root_half_area, &shape);
    });
    shape.node_bytes += subtree->nodes.size() * sizeof(BvhNode);
    shape.reference_bytes += subtree->references.size() * sizeof(uint32_t);
  });
  return shape;
}

}  // namespace deltaray
