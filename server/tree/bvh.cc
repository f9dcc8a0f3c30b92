#include "server/tree/bvh.h"

#include <algorithm>

#include "server/tree/bvh_traversal.h"

namespace deltaray {

void AddNode(const BvhNode& node, uint32_t depth, double root_half_area, TreeShape* shape) {
  // Where the root has no area, every node counts as if rays that meet the root met it.
  const double reached = root_half_area > 0 ? node.bounds.HalfArea() / root_half_area : 1;
  shape->sah_cost += reached * (node.IsLeaf() ? node.count : 1);
  shape->max_depth = std::max(shape->max_depth, depth);
  shape->references += node.count;
  shape->leaves += node.IsLeaf();
  ++shape->nodes;
}

void Bvh::Traverse(const Ray& ray, Collector& collector) const {
  TraverseBvh(arrays_.nodes, BoxTest(ray), collector,
              [&](uint32_t leaf) { collector.Visit(arrays_.LeafReferences(arrays_.nodes[leaf])); });
}

TreeShape Bvh::Shape() const {
  TreeShape shape{.node_bytes = arrays_.nodes.size() * sizeof(BvhNode),
                  .reference_bytes = arrays_.references.size() * sizeof(uint32_t)};
  ForEachNode(arrays_.nodes, 0, [&](uint32_t i, uint32_t depth) {
    AddNode(arrays_.nodes[i], depth, arrays_.nodes[0].bounds.HalfArea(), &shape);
  });
  return shape;
}

}  // namespace deltaray
