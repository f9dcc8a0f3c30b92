// Makes leaves of the lower parts of a binary tree.

#ifndef SERVER_BUILD_COLLAPSE_H_
#define SERVER_BUILD_COLLAPSE_H_

#include <cstdint>
#include <span>
#include <vector>

#include "server/build/clustering.h"
#include "server/build/reference.h"
#include "server/build/sah.h"
#include "server/tree/bvh.h"

namespace deltaray {

// A dendrogram in which every cluster of at most `max_leaf_size` references that is cheaper, by the SAH, as a leaf than
// as a subtree is a leaf. Of all ways to make leaves this is the cheapest.
class CollapsedTree {
 public:
  // `references` must outlive the tree. REQUIRES: they are the dendrogram's; at least one.
  CollapsedTree(std::span<const Reference> references, const Dendrogram& dendrogram, const SahCosts& costs,
                uint32_t max_leaf_size);

  // SAH cost, in the unit of SahCosts.
  double cost() const { return nodes_.back().cost; }
  // Depth of the deepest leaf.
  uint32_t depth() const { return nodes_.back().depth; }

  BvhArrays ToBvhArrays() const;

 private:
  struct Node {
    Bounds bounds;
    uint32_t left = 0, right = 0;
    uint32_t count = 1;  // references below
    uint32_t depth = 0;  // of the deepest leaf below
    bool is_leaf = true;
    double cost = 0;
  };

  std::span<const Reference> references_;
  std::vector<Node> nodes_;  // by cluster
};

}  // namespace deltaray

#endif  // SERVER_BUILD_COLLAPSE_H_
