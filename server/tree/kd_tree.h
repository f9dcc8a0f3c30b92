// A kd-tree: the first of the paper's baselines.

#ifndef SERVER_TREE_KD_TREE_H_
#define SERVER_TREE_KD_TREE_H_

#include <cstdint>
#include <utility>
#include <vector>

#include "server/geometry/bounds.h"
#include "server/tree/traversed_tree.h"

namespace deltaray {

// A node of a kd-tree in depth-first order.
struct KdNode {
  // Inner node: position of the plane; points with coordinate <= position are in the first child, those with >=
  // position in the second.
  float position = 0;
  // Inner node: 0, 1 or 2. Leaf: kLeaf.
  uint32_t axis = kLeaf;
  // Inner node: index of the second child; the first one follows the node. Leaf: index of the first reference.
  uint32_t offset = 0;
  // Number of references of a leaf; may be 0.
  uint32_t count = 0;

  static constexpr uint32_t kLeaf = 3;
  bool IsLeaf() const { return axis == kLeaf; }
};

// The nodes and references of a kd-tree. The root is nodes[0]; no nodes: empty.
struct KdArrays {
  Bounds bounds;  // holds all triangles that are referenced
  std::vector<KdNode> nodes;
  std::vector<uint32_t> references;
};

class KdTree final : public TraversedTree {
 public:
  // `triangles` must outlive the tree.
  // REQUIRES: offsets are within the arrays; every triangle that is not degenerate is in each leaf whose closed cell it
  // touches, but for cells that it touches in a plane that another leaf that has it shares.
  KdTree(TrianglesView triangles, KdArrays arrays) : TraversedTree(triangles), arrays_(std::move(arrays)) {}

  const KdArrays& arrays() const { return arrays_; }

  TreeShape Shape() const override;

 private:
  void Traverse(const Ray& ray, Collector& collector) const override;

  KdArrays arrays_;
};

}  // namespace deltaray

#endif  // SERVER_TREE_KD_TREE_H_
