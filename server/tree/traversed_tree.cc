#include "server/tree/traversed_tree.h"

namespace deltaray {

void TraversedTree::Collect(const Ray& ray, Collector& collector) const {
  if (ray.t_min <= ray.t_max && ray.direction != Vec3f{}) Traverse(ray, collector);
}

void TraversedTree::ClosestHits(std::span<const Ray> rays, const QueryOptions& options, std::span<Hit> hits) const {
  for (size_t i = 0; i < rays.size(); ++i) {
    ClosestCollector collector(triangles_, rays[i], options);
    Collect(rays[i], collector);
    hits[i] = collector.hit();
  }
}

void TraversedTree::AnyHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint8_t> any) const {
  for (size_t i = 0; i < rays.size(); ++i) {
    AnyCollector collector(triangles_, rays[i], options);
    Collect(rays[i], collector);
    any[i] = collector.any();
  }
}

void TraversedTree::AllHits(std::span<const Ray> rays, const QueryOptions& options, std::vector<Hit>* hits,
                            std::span<uint32_t> counts) const {
  std::vector<Candidate> candidates;
  for (size_t i = 0; i < rays.size(); ++i) {
    AllCollector collector(triangles_, rays[i], options, &candidates);
    Collect(rays[i], collector);
    counts[i] = collector.AppendTo(hits);
  }
}

void TraversedTree::CountHits(std::span<const Ray> rays, const QueryOptions& options,
                              std::span<uint32_t> counts) const {
  std::vector<uint32_t> primitives;
  for (size_t i = 0; i < rays.size(); ++i) {
    CountCollector collector(triangles_, rays[i], options, &primitives);
    Collect(rays[i], collector);
    counts[i] = collector.Count();
  }
}

}  // namespace deltaray
