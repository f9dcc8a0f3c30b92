// Which nodes of a binary tree become nodes and leaves of a wide one.

#ifndef SERVER_BUILD_WIDE_PLAN_H_
#define SERVER_BUILD_WIDE_PLAN_H_

#include <cstdint>
#include <span>

#include "server/build/build_context.h"
#include "server/tree/bvh.h"
#include "server/tree/large_memory.h"

namespace deltaray {

// The cheapest wide tree that can be made of a binary one by leaving out nodes, found by dynamic programming as in
// [Ylitie 2017], section 4. Cost: kNodeCost for each node and kLeafCost for each leaf of at most kMaxLeafTriangles
// references, times the area of its box. A leaf costs the same however full it is, since its triangles are tested at
// once.
//
// A binary node is known by its index. Not all nodes are in the wide tree; those that are, are there as a leaf or as a
// node.
class WidePlan {
 public:
  static constexpr float kNodeCost = 1;
  static constexpr float kLeafCost = 1;

  // `nodes`: as in BvhArrays, at least one, with leaves of at most kMaxLeafTriangles references each. `width`: 4, 8 or
  // 16. Runs in the calling thread's TBB arena; the plan does not depend on the number of threads. Means nothing once
  // `context` is cancelled. `nodes` must outlive the plan.
  WidePlan(std::span<const BvhNode> nodes, int width, BuildContext& context);

  // References of `node` where it is a leaf of the wide tree; 0 where it is a node.
  uint32_t LeafSize(uint32_t node) const { return choices_[size_t{node} * width_]; }

  // Writes the children of `node` in the wide tree, which is a node there, from left to right, and returns how many.
  // REQUIRES: the binary node is no leaf; room for `width` of them.
  int Children(uint32_t node, uint32_t* children) const;

 private:
  struct Forest;

  float HalfArea(uint32_t node) const;
  Forest Solve(uint32_t begin, uint32_t end, BuildContext& context);
  Forest SolveSerially(uint32_t begin, uint32_t end);
  Forest SolveLeaf(uint32_t node);
  Forest Join(uint32_t node, const Forest& left, const Forest& right);
  void AppendRoots(uint32_t node, int roots, uint32_t*& children) const;

  std::span<const BvhNode> nodes_;
  const int width_;
  const float scale_;  // of the root's box: UnitScale
  // width_ entries a node. Entry 0: LeafSize. Entry j - 1, for j > 1: how many of at most j roots of the cheapest
  // forest over the node's subtree its first child's part has; 0: fewer than j roots do as well.
  LargeArray<uint8_t> choices_;
};

}  // namespace deltaray

#endif  // SERVER_BUILD_WIDE_PLAN_H_
