// A binary bounding volume hierarchy: what the hybrid, the BVH, the SBVH and [Tang 2015] end as.

#ifndef SERVER_TREE_BVH_H_
#define SERVER_TREE_BVH_H_

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "server/geometry/bounds.h"
#include "server/tree/large_memory.h"
#include "server/tree/traversed_tree.h"

namespace deltaray {

// A node of a binary BVH in depth-first order: 32 bytes, two to a cache line.
struct BvhNode {
  Bounds bounds;  // holds the parts of all triangles below that lie in the node's cell
  // Inner node: index of the second child; the first one follows the node. Leaf: index of the first reference.
  uint32_t offset = 0;
  // Number of references of a leaf. 0: an inner node.
  uint32_t count = 0;

  bool IsLeaf() const { return count != 0; }
};
static_assert(sizeof(BvhNode) == 32);

using BvhNodes = std::vector<BvhNode, LargeAllocator<BvhNode>>;

// The nodes and references of a binary BVH or of a part of one. The root is nodes[0]; no nodes: empty.
struct BvhArrays {
  BvhNodes nodes;
  std::vector<uint32_t> references;  // primitive ids; a triangle that a split cut stands in several leaves

  std::span<const uint32_t> LeafReferences(const BvhNode& leaf) const {
    return std::span(references).subspan(leaf.offset, leaf.count);
  }
};

// Adds one node at `depth` of a tree whose root has half the surface area `root_half_area`: all of `shape` but bytes.
void AddNode(const BvhNode& node, uint32_t depth, double root_half_area, TreeShape* shape);

class Bvh final : public TraversedTree {
 public:
  // `triangles` must outlive the tree.
  // REQUIRES: offsets are within the arrays; every triangle that is not degenerate is, in parts, within its leaves.
  Bvh(TrianglesView triangles, BvhArrays arrays) : TraversedTree(triangles), arrays_(std::move(arrays)) {}

  const BvhArrays& arrays() const { return arrays_; }

  TreeShape Shape() const override;

 private:
  void Traverse(const Ray& ray, Collector& collector) const override;

  BvhArrays arrays_;
};

}  // namespace deltaray

#endif  // SERVER_TREE_BVH_H_
