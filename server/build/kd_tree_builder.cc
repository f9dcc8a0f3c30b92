#include "server/build/kd_tree_builder.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_invoke.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "server/build/kd_plane.h"
#include "server/build/sah.h"
#include "server/geometry/clip_triangle.h"

namespace deltaray {
namespace {

// A split that cuts off empty space is worth this much more. [Wald and Havran 2006], section 3.2.
constexpr double kEmptySpaceBonus = 0.2;
// A split that does not pay may be followed by ones that do; so many on one way down, none of which costs more than
// kMaxLoss times the leaf. As in [Pharr, Jakob and Humphreys 2016], section 4.4.2.
constexpr int kMaxBadSplits = 2;
constexpr double kMaxLoss = 1.5;

class KdTreeBuilder {
 public:
  KdTreeBuilder(const TrianglesView& triangles, const Config& config, BuildContext& context)
      : triangles_(triangles), costs_(config), context_(context) {}

  struct Node {
    ReferenceArray references;
    Bounds cell;
    int levels_left = 0;  // levels of nodes that may stand below
    int bad_splits = 0;   // on the way down to here
    uint64_t budget = 0;  // references that may be added below
  };

  // Appends the tree below `node` to `out`. Ends early, with anything, where the build is cancelled.
  void Build(Node node, KdArrays* out) {
    if (context_.cancelled()) return;
    const double leaf_cost = costs_.Leaf(node.cell.HalfArea(), node.references.size());
    const KdPlane plane = node.levels_left == 0 ? KdPlane() : FindPlane(node);
    if (plane.cost >= leaf_cost) ++node.bad_splits;
    if (!plane.IsFound() || node.bad_splits > kMaxBadSplits || plane.cost > kMaxLoss * leaf_cost) {
      return MakeLeaf(node, out);
    }

    // Not a structured binding, since clang 14 cannot capture one.
    std::pair<Node, Node> halves = Split(node, plane);
    Node &left = halves.first, &right = halves.second;
    const uint64_t children = left.references.size() + right.references.size();
    const uint64_t added = children - std::min<uint64_t>(children, node.references.size());
    if (added > node.budget) return MakeLeaf(node, out);
    context_.spatial_splits.fetch_add(1, std::memory_order_relaxed);
    // What is left of the budget is shared by size, so that it does not depend on the order of tasks.
    const double rest = static_cast<double>(node.budget - added);
    left.budget = children == 0 ? 0 : static_cast<uint64_t>(rest * left.references.size() / children);
    right.budget = node.budget - added - left.budget;
    const bool parallel = node.references.size() >= kTaskReferences;
    node.references = ReferenceArray();

    const size_t index = out->nodes.size();
    out->nodes.push_back({.position = plane.position, .axis = static_cast<uint32_t>(plane.axis)});
    if (!parallel) {
      Build(std::move(left), out);
      out->nodes[index].offset = static_cast<uint32_t>(out->nodes.size());
      Build(std::move(right), out);
      return;
    }
    KdArrays left_tree, right_tree;
    const auto task = [this](Node& child, KdArrays* tree) {
      const BuildContext::CpuTime time(context_);
      Build(std::move(child), tree);
    };
    tbb::parallel_invoke([&] { task(left, &left_tree); }, [&] { task(right, &right_tree); });
    if (context_.cancelled()) return;
    Append(left_tree, out);
    out->nodes[index].offset = static_cast<uint32_t>(out->nodes.size());
    Append(right_tree, out);
  }

 private:
  KdPlane FindPlane(const Node& node) const {
    std::array<KdPlane, 3> planes;
    const auto find = [&](int axis) {
      planes[axis] = FindKdPlane(node.references.span(), node.cell, axis, costs_, kEmptySpaceBonus);
    };
    if (node.references.size() < kTaskReferences) {
      for (int axis = 0; axis < 3; ++axis) find(axis);
    } else {
      tbb::parallel_for(0, 3, [&](int axis) {
        const BuildContext::CpuTime time(context_);
        find(axis);
      });
    }
    return *std::min_element(planes.begin(), planes.end(),
                             [](const KdPlane& a, const KdPlane& b) { return a.cost < b.cost; });
  }

  // The two children, each with the parts of the triangles that lie in its cell.
  std::pair<Node, Node> Split(const Node& node, const KdPlane& plane) {
    size_t left_count = 0, right_count = 0;
    for (const Reference& reference : node.references.span()) {
      left_count += plane.OverlapsLeft(reference.bounds);
      right_count += plane.OverlapsRight(reference.bounds);
    }

    Node left{ReferenceArray(left_count, context_), node.cell, node.levels_left - 1, node.bad_splits};
    Node right{ReferenceArray(right_count, context_), node.cell, node.levels_left - 1, node.bad_splits};
    left.cell.max[plane.axis] = plane.position;
    right.cell.min[plane.axis] = plane.position;
    for (const Reference& reference : node.references.span()) {
      const bool in_left = plane.OverlapsLeft(reference.bounds), in_right = plane.OverlapsRight(reference.bounds);
      if (in_left != in_right) {
        (in_left ? left : right).references.Add(reference);
        continue;
      }
      Bounds left_part, right_part;
      SplitTriangle(triangles_[reference.primitive], plane.axis, plane.position, node.cell, &left_part, &right_part);
      if (!left_part.IsEmpty()) left.references.Add({left_part, reference.primitive});
      if (!right_part.IsEmpty()) right.references.Add({right_part, reference.primitive});
    }
    return {std::move(left), std::move(right)};
  }

  void MakeLeaf(const Node& node, KdArrays* out) {
    out->nodes.push_back({.offset = static_cast<uint32_t>(out->references.size()),
                          .count = static_cast<uint32_t>(node.references.size())});
    for (const Reference& reference : node.references.span()) out->references.push_back(reference.primitive);
    context_.references_placed.fetch_add(node.references.size(), std::memory_order_relaxed);
  }

  // Appends a subtree, moving its indices to where its nodes and references now stand.
  static void Append(const KdArrays& subtree, KdArrays* out) {
    const auto first_node = static_cast<uint32_t>(out->nodes.size());
    const auto first_reference = static_cast<uint32_t>(out->references.size());
    for (KdNode node : subtree.nodes) {
      node.offset += node.IsLeaf() ? first_reference : first_node;
      out->nodes.push_back(node);
    }
    out->references.insert(out->references.end(), subtree.references.begin(), subtree.references.end());
  }

  const TrianglesView triangles_;
  const SahCosts costs_;
  BuildContext& context_;
};

}  // namespace

absl::StatusOr<KdArrays> BuildKdTree(std::span<const Reference> references, const TrianglesView& triangles,
                                     const Config& config, BuildContext& context) {
  KdArrays arrays;
  if (references.empty()) return arrays;
  KdTreeBuilder::Node root;
  root.references = ReferenceArray(references.size(), context);
  std::copy(references.begin(), references.end(), root.references.data());
  root.references.set_size(references.size());
  for (const Reference& reference : references) root.cell.Extend(reference.bounds);
  arrays.bounds = root.cell;

  const double count = static_cast<double>(references.size());
  // [Havran 2000], section 4.5.
  root.levels_left = 8 + static_cast<int>(1.3 * std::log2(count));
  // Indices of references have 32 bits.
  root.budget =
      static_cast<uint64_t>(std::min(count * config.duplication_budget, std::numeric_limits<int32_t>::max() - count));
  KdTreeBuilder(triangles, config, context).Build(std::move(root), &arrays);
  if (context.cancelled()) return absl::CancelledError("the build was cancelled");
  return arrays;
}

}  // namespace deltaray
