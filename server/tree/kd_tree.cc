#include "server/tree/kd_tree.h"

#include <algorithm>
#include <span>

#include "absl/container/inlined_vector.h"
#include "server/geometry/box_test.h"

namespace deltaray {

void KdTree::Traverse(const Ray& ray, Collector& collector) const {
  if (arrays_.nodes.empty()) return;
  // A cell, and an interval that holds every t at which the ray is in the closed cell. Neighbours' intervals overlap a
  // little, so that a point in a plane is found on both sides.
  struct Entry {
    uint32_t node;
    Interval t;
  };
  absl::InlinedVector<Entry, 64> stack;
  const BoxTest box_test(ray);
  const auto push = [&](uint32_t node, Interval t) {
    if (!t.IsEmpty()) stack.push_back({node, t});
  };
  push(0, box_test(arrays_.bounds, collector.limit()));
  while (!stack.empty() && !collector.stop().Step()) {
    const auto [index, t] = stack.back();
    stack.pop_back();
    // A triangle of a near cell may have been hit beyond that cell: only the limit tells when later cells are done.
    if (t.first > collector.limit()) continue;
    const KdNode& node = arrays_.nodes[index];
    if (node.IsLeaf()) {
      collector.Visit(std::span(arrays_.references).subspan(node.offset, node.count));
      continue;
    }
    const int axis = static_cast<int>(node.axis);
    const uint32_t below = index + 1, above = node.offset;
    if (box_test.IsParallel(axis)) {
      if (box_test.origin(axis) >= node.position) push(above, t);
      if (box_test.origin(axis) <= node.position) push(below, t);
      continue;
    }
    const double crossing = box_test.Crossing(axis, node.position);
    const bool downward = box_test.IsNegative(axis);
    push(downward ? below : above, {std::max(t.first, BoxTest::Earlier(crossing)), t.last});
    push(downward ? above : below, {t.first, std::min(t.last, BoxTest::Later(crossing))});
  }
}

TreeShape KdTree::Shape() const {
  TreeShape shape{.node_bytes = arrays_.nodes.size() * sizeof(KdNode),
                  .reference_bytes = arrays_.references.size() * sizeof(uint32_t)};
  if (arrays_.nodes.empty()) return shape;
  const double root_half_area = arrays_.bounds.HalfArea();
  struct Entry {
    uint32_t node, depth;
    Bounds cell;
  };
  std::vector<Entry> stack = {{0, 0, arrays_.bounds}};
  while (!stack.empty()) {
    const Entry entry = stack.back();
    stack.pop_back();
    const KdNode& node = arrays_.nodes[entry.node];
    const double reached = root_half_area > 0 ? entry.cell.HalfArea() / root_half_area : 1;
    shape.sah_cost += reached * (node.IsLeaf() ? node.count : 1);
    shape.max_depth = std::max(shape.max_depth, entry.depth);
    ++shape.nodes;
    if (node.IsLeaf()) {
      ++shape.leaves;
      shape.references += node.count;
      continue;
    }
    Entry below{entry.node + 1, entry.depth + 1, entry.cell}, above{node.offset, entry.depth + 1, entry.cell};
    below.cell.max[node.axis] = above.cell.min[node.axis] = node.position;
    stack.push_back(above);
    stack.push_back(below);
  }
  return shape;
}

}  // namespace deltaray
