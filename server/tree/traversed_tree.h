// The four queries, made of one traversal.

#ifndef SERVER_TREE_TRAVERSED_TREE_H_
#define SERVER_TREE_TRAVERSED_TREE_H_

#include "server/tree/collector.h"
#include "server/tree/tree.h"

namespace deltaray {

// A tree that answers rays one by one, exactly.
class TraversedTree : public Tree {
 public:
  void ClosestHits(std::span<const Ray> rays, const QueryOptions& options, std::span<Hit> hits) const override;
  void AnyHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint8_t> any) const override;
  void AllHits(std::span<const Ray> rays, const QueryOptions& options, std::vector<Hit>* hits,
               std::span<uint32_t> counts) const final;
  void CountHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint32_t> counts) const final;
  AccuracyLevel answered_accuracy(AccuracyLevel) const override { return AccuracyLevel::kExact; }

 protected:
  // `triangles` must outlive the tree.
  explicit TraversedTree(TrianglesView triangles) : triangles_(triangles) {}

  const TrianglesView& triangles() const { return triangles_; }

  // One ray of a query, which `stop` may end.
  Hit ClosestHit(const Ray& ray, const QueryOptions& options, StopPoll& stop) const;
  bool AnyHit(const Ray& ray, const QueryOptions& options, StopPoll& stop) const;

 private:
  // Brings all triangles that `ray` hits at an exact t <= collector.limit() to the collector, near ones first as far as
  // the structure knows. The ray has a direction and t_min <= t_max.
  virtual void Traverse(const Ray& ray, Collector& collector) const = 0;

  void Collect(const Ray& ray, Collector& collector) const;

  TrianglesView triangles_;
};

}  // namespace deltaray

#endif  // SERVER_TREE_TRAVERSED_TREE_H_
