#include "server/build/top_down.h"

#include <tbb/parallel_invoke.h>

#include <algorithm>
#include <tuple>
#include <utility>

#include "server/build/object_split.h"
#include "server/build/reduce_references.h"
#include "server/build/sah.h"
#include "server/build/spatial_split.h"

namespace deltaray {
namespace {

// The part of the reference array that a node owns: its references, then room for more.
struct Range {
  size_t begin = 0, end = 0, limit = 0;

  size_t size() const { return end - begin; }
  size_t room() const { return limit - end; }
};

class TopDownBuilder {
 public:
  TopDownBuilder(ReferenceArray references, const TrianglesView& triangles, const Config& config, bool delta_leaves,
                 BuildContext& context)
      : references_(std::move(references)),
        triangles_(triangles),
        config_(config),
        costs_(config),
        delta_leaves_(delta_leaves),
        max_leaf_size_(delta_leaves ? config.delta : config.max_leaf_size),
        context_(context) {}

  absl::StatusOr<SplitTree> Build() {
    BvhNodes nodes;
    if (references_.size() > 0) {
      Build({0, references_.size(), references_.capacity()}, 0, nodes);
      CloseGaps(nodes);
    }
    if (context_.cancelled()) return absl::CancelledError("the build was cancelled");
    return SplitTree{std::move(nodes), std::move(references_)};
  }

 private:
  std::span<Reference> span(const Range& range) { return {references_.data() + range.begin, range.size()}; }

  // Appends the subtree over `range` to `nodes`, depth-first. Leaves' offsets point into references_.
  void Build(Range range, uint32_t depth, BvhNodes& nodes) {
    const BoundsSum sum = SumBounds(span(range), context_);
    if (context_.cancelled()) return;
    const Bounds bounds = static_cast<Bounds>(sum.bounds);
    const double half_area = bounds.HalfArea();
    if (depth == 0) root_half_area_ = half_area;
    const size_t node = nodes.size();
    nodes.push_back({bounds});

    // 1. Find the cheapest split; stop where none is worth it.
    const bool may_be_leaf = range.size() <= max_leaf_size_;
    if (may_be_leaf && delta_leaves_) return MakeLeaf(range, nodes[node]);
    ObjectSplit object_split;
    SpatialSplit spatial_split;
    if (depth < kSahDepth) {
      object_split = FindObjectSplit(span(range), sum, costs_, context_);
      if (MaySplitInSpace(range, bounds, object_split)) {
        spatial_split = FindSpatialSplit(span(range), triangles_, bounds, costs_, range.room(), context_);
      }
    }
    const double leaf_cost = costs_.Leaf(half_area, static_cast<uint32_t>(range.size()));
    const double split_cost = costs_.Split(half_area, std::min(object_split.cost, spatial_split.cost));
    if (may_be_leaf && leaf_cost <= split_cost) return MakeLeaf(range, nodes[node]);

    // 2. Split: in space only where that pays, else by objects, and at the median where nothing else does.
    size_t left_size;
    if (spatial_split.cost < object_split.cost && split_cost < leaf_cost) {
      context_.spatial_splits.fetch_add(1, std::memory_order_relaxed);
      const std::span<Reference> references_and_room(references_.data() + range.begin, range.limit - range.begin);
      const auto parts = Partition(references_and_room, range.size(), triangles_, spatial_split, context_);
      left_size = parts.first;
      range.end = range.begin + parts.first + parts.second;
    } else if (object_split.IsFound()) {
      context_.object_splits.fetch_add(1, std::memory_order_relaxed);
      left_size = Partition(span(range), object_split, context_);
    } else {
      context_.median_splits.fetch_add(1, std::memory_order_relaxed);
      left_size = PartitionAtMedian(span(range), bounds);
    }
    if (context_.cancelled()) return;
    const auto [left, right] = ShareRoom(range, left_size);

    // 3. Build both children.
    if (range.size() < kTaskReferences) {
      Build(left, depth + 1, nodes);
      nodes[node].offset = static_cast<uint32_t>(nodes.size());
      Build(right, depth + 1, nodes);
      return;
    }
    BvhNodes right_nodes;
    tbb::parallel_invoke(
        [&, left = left] {
          const BuildContext::CpuTime time(context_);
          Build(left, depth + 1, nodes);
        },
        [&, right = right] {
          const BuildContext::CpuTime time(context_);
          Build(right, depth + 1, right_nodes);
        });
    const uint32_t base = static_cast<uint32_t>(nodes.size());
    nodes[node].offset = base;
    for (BvhNode& right_node : right_nodes) {
      if (!right_node.IsLeaf()) right_node.offset += base;
    }
    nodes.insert(nodes.end(), right_nodes.begin(), right_nodes.end());
  }

  // Whether the best object split's children overlap by enough.
  bool MaySplitInSpace(const Range& range, const Bounds& bounds, const ObjectSplit& split) const {
    if (range.room() == 0) return false;
    const Bounds overlap = split.IsFound() ? Intersection(split.left, split.right) : bounds;
    return config_.spatial_split_gate == 0 || overlap.HalfArea() > config_.spatial_split_gate * root_half_area_;
  }

  void MakeLeaf(const Range& range, BvhNode& node) {
    node.offset = static_cast<uint32_t>(range.begin);
    node.count = static_cast<uint32_t>(range.size());
    context_.references_placed.fetch_add(range.size(), std::memory_order_relaxed);
    if (delta_leaves_) context_.CountDeltaLeaf(node.count);
  }

  // Splits `range` after `left_size` references, and its room in proportion to the sides' references. The right side
  // moves up.
  std::pair<Range, Range> ShareRoom(const Range& range, size_t left_size) {
    const size_t middle = range.begin + left_size, right_size = range.end - middle;
    const size_t left_room =
        static_cast<size_t>(static_cast<double>(range.room()) * static_cast<double>(left_size) / range.size());
    // Only as many references move as the gap is wide: their order does not matter.
    const size_t moved = std::min(left_room, right_size);
    const size_t right_begin = middle + left_room;
    Reference* const data = references_.data();
    std::copy_backward(data + middle, data + middle + moved, data + right_begin + right_size);
    return {{range.begin, middle, right_begin}, {right_begin, right_begin + right_size, range.limit}};
  }

  // Moves the leaves' references together.
  void CloseGaps(BvhNodes& nodes) {
    size_t size = 0;
    Reference* const data = references_.data();
    for (BvhNode& node : nodes) {
      if (context_.cancelled()) return;
      if (!node.IsLeaf()) continue;
      std::copy(data + node.offset, data + node.offset + node.count, data + size);
      node.offset = static_cast<uint32_t>(size);
      size += node.count;
    }
    references_.set_size(size);
    references_.ShrinkToFit();
  }

  ReferenceArray references_;
  const TrianglesView triangles_;
  const Config& config_;
  const SahCosts costs_;
  const bool delta_leaves_;  // whether leaves are δ-leaves
  const size_t max_leaf_size_;
  BuildContext& context_;
  double root_half_area_ = 0;
};

}  // namespace

absl::StatusOr<SplitTree> BuildTop(ReferenceArray references, const TrianglesView& triangles, const Config& config,
                                   BuildContext& context) {
  return TopDownBuilder(std::move(references), triangles, config, true, context).Build();
}

absl::StatusOr<SplitTree> BuildTopDown(ReferenceArray references, const TrianglesView& triangles, const Config& config,
                                       BuildContext& context) {
  return TopDownBuilder(std::move(references), triangles, config, false, context).Build();
}

BvhArrays ToBvhArrays(const SplitTree& tree) {
  BvhArrays arrays;
  arrays.nodes = tree.nodes;
  arrays.references.reserve(tree.references.size());
  for (const Reference& reference : tree.references.span()) arrays.references.push_back(reference.primitive);
  return arrays;
}

}  // namespace deltaray
