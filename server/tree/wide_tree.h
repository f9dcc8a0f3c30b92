// The tree that answers most rays: wide nodes traversed by vector instructions.

#ifndef SERVER_TREE_WIDE_TREE_H_
#define SERVER_TREE_WIDE_TREE_H_

#include "server/tree/traversed_tree.h"
#include "server/tree/wide_arrays.h"

namespace deltaray {

// What the hybrid, the BVH and the SBVH end as.
class WideTree final : public TraversedTree {
 public:
  // `triangles` must outlive the tree.
  // REQUIRES: this processor supports arrays.target; every triangle that is not degenerate is, in parts, within the
  // boxes of its leaves.
  WideTree(TrianglesView triangles, WideArrays arrays);

  const WideArrays& arrays() const { return arrays_; }

  void ClosestHits(std::span<const Ray> rays, const QueryOptions& options, std::span<Hit> hits) const override;
  void AnyHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint8_t> any) const override;
  AccuracyLevel answered_accuracy(AccuracyLevel level) const override { return level; }
  TreeShape Shape() const override;

 private:
  void Traverse(const Ray& ray, Collector& collector) const override;

  WideArrays arrays_;
};

}  // namespace deltaray

#endif  // SERVER_TREE_WIDE_TREE_H_
