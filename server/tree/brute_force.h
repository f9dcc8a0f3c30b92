// The reference that all structures are checked against: every ray against every triangle.

#ifndef SERVER_TREE_BRUTE_FORCE_H_
#define SERVER_TREE_BRUTE_FORCE_H_

#include "server/tree/tree.h"

namespace deltaray {

class BruteForce final : public Tree {
 public:
  // `triangles` must outlive the tree.
  explicit BruteForce(TrianglesView triangles) : triangles_(triangles) {}

  void ClosestHits(std::span<const Ray> rays, const QueryOptions& options, std::span<Hit> hits) const override;
  void AnyHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint8_t> any) const override;
  void AllHits(std::span<const Ray> rays, const QueryOptions& options, std::vector<Hit>* hits,
               std::span<uint32_t> counts) const override;
  void CountHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint32_t> counts) const override;
  AccuracyLevel answered_accuracy(AccuracyLevel) const override { return AccuracyLevel::kExact; }
  TreeShape Shape() const override;

 private:
  TrianglesView triangles_;
};

}  // namespace deltaray

#endif  // SERVER_TREE_BRUTE_FORCE_H_
