#include "server/build/layout.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <span>

#include "server/build/group_references.h"
#include "server/tree/large_memory.h"

namespace deltaray {
namespace {

// More would take longer than a cancel may.
constexpr size_t kElementsAtOnce = 1 << 16;

// As `array`.resize(`size`), which it is not where the build is cancelled.
template <typename Array>
void Resize(size_t size, BuildContext& context, Array& array) {
  array.reserve(size);
  while (array.size() < size && !context.cancelled()) array.resize(std::min(array.size() + kElementsAtOnce, size));
}

}  // namespace

absl::StatusOr<BinaryLayout> LayOut(const DeltaLeafTasks& delta_leaves, BuildContext& context) {
  const std::span<const BvhNode> top = delta_leaves.top();
  BinaryLayout layout;

  // 1. Where each node of the top goes: in depth-first order, a node stands after all that comes before it.
  struct Place {
    uint32_t node;
    uint32_t reference;
    uint32_t delta_leaf;  // of a leaf of the top
    bool is_built;        // by now
  };
  LargeArray<Place> places(top.size());
  uint32_t delta_leaf = 0, nodes = 0, references = 0;
  for (size_t i = 0; i < top.size(); ++i) {
    if (i % kElementsAtOnce == 0 && context.cancelled()) return absl::CancelledError("the build was cancelled");
    places[i] = {nodes, references, delta_leaf, false};
    if (!top[i].IsLeaf()) {
      ++nodes;
      continue;
    }
    const DeltaLeafTree subtree = delta_leaves.built(delta_leaf);
    places[i].is_built = !subtree.nodes.empty();
    if (places[i].is_built) {
      nodes += static_cast<uint32_t>(subtree.nodes.size());
      references += static_cast<uint32_t>(subtree.references.size());
    } else {
      layout.unbuilt.push_back({delta_leaf, references, references + top[i].count});
      nodes += GroupNodes(top[i].count);
      references += top[i].count;
    }
    ++delta_leaf;
  }

  // 2. Put it there.
  BvhArrays& arrays = layout.arrays;
  Resize(nodes, context, arrays.nodes);
  Resize(references, context, arrays.references);
  if (context.cancelled()) return absl::CancelledError("the build was cancelled");
  tbb::parallel_for(tbb::blocked_range<size_t>(0, top.size(), 64), [&](const tbb::blocked_range<size_t>& range) {
    if (context.cancelled()) return;
    const BuildContext::CpuTime time(context);
    std::vector<Reference> list;
    for (size_t i = range.begin(); i < range.end(); ++i) {
      const Place& place = places[i];
      if (!top[i].IsLeaf()) {
        arrays.nodes[place.node] = {top[i].bounds, places[top[i].offset].node, 0};
      } else if (place.is_built) {
        const DeltaLeafTree subtree = delta_leaves.built(place.delta_leaf);
        std::transform(subtree.nodes.begin(), subtree.nodes.end(), arrays.nodes.begin() + place.node,
                       [&](BvhNode node) {
                         node.offset += node.IsLeaf() ? place.reference : place.node;
                         return node;
                       });
        std::copy(subtree.references.begin(), subtree.references.end(), arrays.references.begin() + place.reference);
      } else {
        const std::span<const Reference> of_delta_leaf = delta_leaves.references(place.delta_leaf);
        list.assign(of_delta_leaf.begin(), of_delta_leaf.end());
        GroupReferences(list, place.node, place.reference, &arrays);
      }
    }
  });
  if (context.cancelled()) return absl::CancelledError("the build was cancelled");
  return layout;
}

}  // namespace deltaray
