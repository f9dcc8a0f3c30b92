#include "server/build/layout.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <vector>

namespace deltaray {

absl::StatusOr<BvhArrays> LayOut(const ProvisionalTree& tree, BuildContext& context) {
  const std::vector<BvhNode>& top = tree.top().nodes;

  // 1. Where each node of the top goes: in depth-first order, a node stands after all that comes before it.
  struct Place {
    uint32_t node = 0;
    uint32_t reference = 0;
    const BvhArrays* subtree = nullptr;  // of a δ-leaf
  };
  std::vector<Place> places(top.size());
  uint32_t delta_leaf = 0, nodes = 0, references = 0;
  for (size_t i = 0; i < top.size(); ++i) {
    places[i] = {nodes, references, top[i].IsLeaf() ? tree.delta_leaf(delta_leaf++) : nullptr};
    nodes += places[i].subtree == nullptr ? 1 : static_cast<uint32_t>(places[i].subtree->nodes.size());
    references += places[i].subtree == nullptr ? 0 : static_cast<uint32_t>(places[i].subtree->references.size());
  }

  // 2. Put it there.
  BvhArrays arrays;
  arrays.nodes.resize(nodes);
  arrays.references.resize(references);
  tbb::parallel_for(tbb::blocked_range<size_t>(0, top.size(), 64), [&](const tbb::blocked_range<size_t>& range) {
    if (context.cancelled()) return;
    const BuildContext::CpuTime time(context);
    for (size_t i = range.begin(); i < range.end(); ++i) {
      const Place& place = places[i];
      if (place.subtree == nullptr) {
        arrays.nodes[place.node] = {top[i].bounds, places[top[i].offset].node, 0};
        continue;
      }
      std::transform(place.subtree->nodes.begin(), place.subtree->nodes.end(), arrays.nodes.begin() + place.node,
                     [&](BvhNode node) {
                       node.offset += node.IsLeaf() ? place.reference : place.node;
                       return node;
                     });
      std::copy(place.subtree->references.begin(), place.subtree->references.end(),
                arrays.references.begin() + place.reference);
    }
  });
  if (context.cancelled()) return absl::CancelledError("the build was cancelled");
  return arrays;
}

}  // namespace deltaray
