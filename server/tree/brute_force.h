// The reference that all structures are checked against: every ray against every triangle.

#ifndef SERVER_TREE_BRUTE_FORCE_H_
#define SERVER_TREE_BRUTE_FORCE_H_

#include "server/tree/traversed_tree.h"

namespace deltaray {

class BruteForce final : public TraversedTree {
 public:
  // `triangles` must outlive the tree.
  explicit BruteForce(TrianglesView triangles) : TraversedTree(triangles) {}

  // One leaf with all triangles.
  TreeShape Shape() const override;

 private:
  void Traverse(const Ray& ray, Collector& collector) const override;
};

}  // namespace deltaray

#endif  // SERVER_TREE_BRUTE_FORCE_H_
