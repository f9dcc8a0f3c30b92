// The tree that answers rays while its δ-leaves are still being built.

#ifndef SERVER_TREE_PROVISIONAL_TREE_H_
#define SERVER_TREE_PROVISIONAL_TREE_H_

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "server/geometry/bounds.h"
#include "server/tree/bvh.h"
#include "server/tree/traversed_tree.h"

namespace deltaray {

// A top of spatial and object splits whose leaves are δ-leaves. A δ-leaf that is not built yet is a plain list of
// references; once built it is a small BVH of its own. Answers have the same bits either way.
//
// Thread-safety: queries from any number of threads, while other threads publish δ-leaves. A δ-leaf goes from list to
// BVH once and stays.
class ProvisionalTree final : public TraversedTree {
 public:
  // Called, from whichever thread traces, before a δ-leaf that is not built is first searched; may publish it, from any
  // thread, or leave it. Used by lazy builds. Must not throw, and must be quick where it has nothing to do.
  using ReachDeltaLeaf = std::function<void(uint32_t delta_leaf)>;

  // `top`: a BVH each of whose leaves is one δ-leaf: its references are the δ-leaf's list. δ-leaves are numbered in the
  // order of the leaves in top.nodes. `triangles` must outlive the tree.
  ProvisionalTree(TrianglesView triangles, BvhArrays top, ReachDeltaLeaf reach_delta_leaf = nullptr);
  ~ProvisionalTree() override;

  uint32_t delta_leaf_count() const;
  uint32_t delta_leaves_built() const;
  const BvhArrays& top() const { return top_; }

  // Makes `subtree`, whose leaves hold primitive ids, the δ-leaf's BVH. REQUIRES: called at most once for a δ-leaf.
  void PublishDeltaLeaf(uint32_t delta_leaf, std::unique_ptr<const BvhArrays> subtree);

  // The δ-leaf's BVH, or nullptr where it is not built yet.
  const BvhArrays* delta_leaf(uint32_t delta_leaf) const;

  TreeShape Shape() const override;

 private:
  void Traverse(const Ray& ray, Collector& collector) const override;

  BvhArrays top_;
  std::vector<uint32_t> delta_leaf_of_node_;                 // of inner nodes: not used
  std::vector<std::atomic<const BvhArrays*>> delta_leaves_;  // owned; nullptr: not built yet
  std::atomic<uint32_t> built_{0};
  ReachDeltaLeaf reach_delta_leaf_;
};

}  // namespace deltaray

#endif  // SERVER_TREE_PROVISIONAL_TREE_H_
