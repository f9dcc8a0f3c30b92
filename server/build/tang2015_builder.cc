#include "server/build/tang2015_builder.h"

#include <tbb/parallel_invoke.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "server/build/clustering.h"
#include "server/build/collapse.h"
#include "server/build/kd_plane.h"
#include "server/build/object_split.h"
#include "server/build/reduce_references.h"
#include "server/build/sah.h"

namespace deltaray {
namespace {

// The nodes and references of a part of the tree.
struct Subtree {
  BvhNodes nodes;
  std::vector<Reference> references;
};

class TopBuilder {
 public:
  TopBuilder(const Config& config, BuildContext& context)
      : costs_(config), max_leaf_size_(std::max(config.delta, 2u) - 1), context_(context) {}

  struct Node {
    ReferenceArray references;  // with whole boxes
    Bounds cell;
    uint32_t depth = 0;
    size_t room = 0;  // references that may be added below
  };

  // Appends the tree below `node` to `out`. Ends early, with anything, where the build is cancelled.
  void Split(Node node, Subtree* out) {
    if (context_.cancelled()) return;
    if (node.references.size() <= max_leaf_size_) return MakeDeltaLeaf(node, out);

    Node left{{}, {}, node.depth + 1}, right{{}, {}, node.depth + 1};
    if (node.depth >= kSahDepth || !SplitInSpace(node, &left, &right)) SplitObjects(node, &left, &right);
    const size_t children = left.references.size() + right.references.size();
    const size_t room = node.room - (children - node.references.size());
    left.room = static_cast<size_t>(static_cast<double>(room) * left.references.size() / children);
    right.room = room - left.room;
    const bool parallel = node.references.size() >= kTaskReferences;
    node.references = ReferenceArray();

    const size_t index = out->nodes.size();
    out->nodes.push_back({node.cell});
    if (!parallel) {
      Split(std::move(left), out);
      out->nodes[index].offset = static_cast<uint32_t>(out->nodes.size());
      Split(std::move(right), out);
      return;
    }
    Subtree right_tree;
    const auto task = [this](Node& child, Subtree* tree) {
      const BuildContext::CpuTime time(context_);
      Split(std::move(child), tree);
    };
    tbb::parallel_invoke([&] { task(left, out); }, [&] { task(right, &right_tree); });
    out->nodes[index].offset = static_cast<uint32_t>(out->nodes.size());
    Append(right_tree, out);
  }

 private:
  // Lines 11 to 25 of table 1. False where the split must give way.
  bool SplitInSpace(const Node& node, Node* left, Node* right) {
    Bounds box;
    for (const Reference& reference : node.references.span()) box.Extend(reference.bounds);
    const int axis = Intersection(box, node.cell).WidestAxis();
    const KdPlane plane = FindKdPlane(node.references.span(), node.cell, axis, costs_, 0);
    if (!plane.IsFound()) return false;

    size_t left_count = 0, right_count = 0;
    for (const Reference& reference : node.references.span()) {
      left_count += plane.OverlapsLeft(reference.bounds);
      right_count += plane.OverlapsRight(reference.bounds);
    }
    const size_t count = node.references.size();
    if (std::max(left_count, right_count) == count || left_count + right_count - count > node.room) return false;

    left->cell = right->cell = node.cell;
    left->cell.max[axis] = right->cell.min[axis] = plane.position;
    left->references = ReferenceArray(left_count, context_);
    right->references = ReferenceArray(right_count, context_);
    for (const Reference& reference : node.references.span()) {
      if (plane.OverlapsLeft(reference.bounds)) left->references.Add(reference);
      if (plane.OverlapsRight(reference.bounds)) right->references.Add(reference);
    }
    context_.spatial_splits.fetch_add(1, std::memory_order_relaxed);
    return true;
  }

  // The guard: each reference goes to one side.
  void SplitObjects(Node& node, Node* left, Node* right) {
    const std::span<Reference> references = node.references.span();
    ObjectSplit split;
    if (node.depth < kSahDepth) {
      const BoundsSum sum = SumBounds(references, context_);
      if (context_.cancelled()) return;
      split = FindObjectSplit(references, sum, costs_, context_);
    }
    size_t middle;
    if (split.IsFound()) {
      context_.object_splits.fetch_add(1, std::memory_order_relaxed);
      middle = Partition(references, split, context_);
    } else {
      context_.median_splits.fetch_add(1, std::memory_order_relaxed);
      middle = PartitionAtMedian(references, node.cell);
    }
    FillChild(references.first(middle), node.cell, left);
    FillChild(references.subspan(middle), node.cell, right);
  }

  void FillChild(std::span<const Reference> references, const Bounds& cell, Node* child) {
    child->references = ReferenceArray(references.size(), context_);
    for (const Reference& reference : references) {
      child->references.Add(reference);
      child->cell.Extend(reference.bounds);
    }
    child->cell = Intersection(child->cell, cell);
  }

  void MakeDeltaLeaf(const Node& node, Subtree* out) {
    const auto count = static_cast<uint32_t>(node.references.size());
    out->nodes.push_back({node.cell, static_cast<uint32_t>(out->references.size()), count});
    const std::span<const Reference> references = node.references.span();
    out->references.insert(out->references.end(), references.begin(), references.end());
    context_.references_placed.fetch_add(count, std::memory_order_relaxed);
    context_.CountDeltaLeaf(count);
  }

  // Appends a subtree, moving its offsets to where its nodes and references now stand.
  static void Append(const Subtree& subtree, Subtree* out) {
    const auto first_node = static_cast<uint32_t>(out->nodes.size());
    const auto first_reference = static_cast<uint32_t>(out->references.size());
    for (BvhNode node : subtree.nodes) {
      node.offset += node.IsLeaf() ? first_reference : first_node;
      out->nodes.push_back(node);
    }
    out->references.insert(out->references.end(), subtree.references.begin(), subtree.references.end());
  }

  const SahCosts costs_;
  const size_t max_leaf_size_;
  BuildContext& context_;
};

}  // namespace

absl::StatusOr<SplitTree> BuildTang2015Top(ReferenceArray references, const Config& config, BuildContext& context) {
  if (references.size() == 0) return SplitTree();
  TopBuilder::Node root;
  root.room = references.capacity() - references.size();
  for (const Reference& reference : references.span()) root.cell.Extend(reference.bounds);
  root.references = std::move(references);
  Subtree tree;
  TopBuilder(config, context).Split(std::move(root), &tree);
  if (context.cancelled()) return absl::CancelledError("the build was cancelled");

  SplitTree result{std::move(tree.nodes), ReferenceArray(tree.references.size(), context)};
  for (const Reference& reference : tree.references) result.references.Add(reference);
  return result;
}

BvhArrays BuildTang2015DeltaLeaf(std::span<const Reference> references, const Bounds& mesh_bounds, const Config& config,
                                 const BuildContext& context) {
  const Dendrogram dendrogram = Cluster(references, ClusteringCost(config.alpha, config, mesh_bounds, 1), context);
  if (context.cancelled()) return BvhArrays();
  return CollapsedTree(references, dendrogram, SahCosts(config), 1).ToBvhArrays();
}

}  // namespace deltaray
