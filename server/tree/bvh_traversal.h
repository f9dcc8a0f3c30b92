// Ordered traversal of a binary BVH, and a walk over its nodes.

#ifndef SERVER_TREE_BVH_TRAVERSAL_H_
#define SERVER_TREE_BVH_TRAVERSAL_H_

#include <cstdint>
#include <span>
#include <vector>

#include "absl/container/inlined_vector.h"
#include "server/geometry/box_test.h"
#include "server/tree/bvh.h"
#include "server/tree/collector.h"

namespace deltaray {

// Calls visit_leaf(index of the leaf's node) for each leaf that the ray reaches at a t <= collector.limit(), the nearer
// child first: [Tang 2015] table 3 with the array stack that it names. The stack grows on the heap where the tree is
// deeper than 64.
template <typename VisitLeaf>
void TraverseBvh(std::span<const BvhNode> nodes, const BoxTest& box_test, Collector& collector, VisitLeaf visit_leaf) {
  if (nodes.empty()) return;
  struct Entry {
    uint32_t node;
    double first;
  };
  absl::InlinedVector<Entry, 64> stack;
  const Interval root = box_test(nodes[0].bounds, collector.limit());
  if (!root.IsEmpty()) stack.push_back({0, root.first});
  while (!stack.empty() && !collector.stop().Step()) {
    const Entry entry = stack.back();
    stack.pop_back();
    if (entry.first > collector.limit()) continue;
    const BvhNode& node = nodes[entry.node];
    if (node.IsLeaf()) {
      visit_leaf(entry.node);
      continue;
    }
    const Interval left = box_test(nodes[entry.node + 1].bounds, collector.limit());
    const Interval right = box_test(nodes[node.offset].bounds, collector.limit());
    const bool left_is_near = left.first <= right.first;
    if (left_is_near && !right.IsEmpty()) stack.push_back({node.offset, right.first});
    if (!left.IsEmpty()) stack.push_back({entry.node + 1, left.first});
    if (!left_is_near && !right.IsEmpty()) stack.push_back({node.offset, right.first});
  }
}

// Calls visit(index, depth) for each node in order; the root has depth `root_depth`.
template <typename Visit>
void ForEachNode(std::span<const BvhNode> nodes, uint32_t root_depth, Visit visit) {
  std::vector<uint32_t> depths(nodes.size(), root_depth);
  for (uint32_t i = 0; i < nodes.size(); ++i) {
    if (!nodes[i].IsLeaf()) depths[i + 1] = depths[nodes[i].offset] = depths[i] + 1;
    visit(i, depths[i]);
  }
}

}  // namespace deltaray

#endif  // SERVER_TREE_BVH_TRAVERSAL_H_
