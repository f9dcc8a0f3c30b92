#include "server/tree/traversed_tree.h"

namespace deltaray {

void TraversedTree::Collect(const Ray& ray, Collector& collector) const {
  if (ray.t_min <= ray.t_max && ray.direction != Vec3f{}) Traverse(ray, collector);
}

Hit TraversedTree::ClosestHit(const Ray& ray, const QueryOptions& options, StopPoll& stop) const {
  ClosestCollector collector(triangles_, ray, options, stop);
  Collect(ray, collector);
  return collector.hit();
}

bool TraversedTree::AnyHit(const Ray& ray, const QueryOptions& options, StopPoll& stop) const {
  AnyCollector collector(triangles_, ray, options, stop);
  Collect(ray, collector);
  return collector.any();
}

void TraversedTree::ClosestHits(std::span<const Ray> rays, const QueryOptions& options, std::span<Hit> hits) const {
  StopPoll stop(options.stopped);
  for (size_t i = 0; i < rays.size(); ++i) hits[i] = ClosestHit(rays[i], options, stop);
}

void TraversedTree::AnyHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint8_t> any) const {
  StopPoll stop(options.stopped);
  for (size_t i = 0; i < rays.size(); ++i) any[i] = AnyHit(rays[i], options, stop);
}

void TraversedTree::AllHits(std::span<const Ray> rays, const QueryOptions& options, std::vector<Hit>* hits,
                            std::span<uint32_t> counts) const {
  StopPoll stop(options.stopped);
  std::vector<Candidate> candidates;
  for (size_t i = 0; i < rays.size(); ++i) {
    AllCollector collector(triangles_, rays[i], options, stop, &candidates);
    Collect(rays[i], collector);
    counts[i] = collector.AppendTo(hits);
  }
}

void TraversedTree::CountHits(std::span<const Ray> rays, const QueryOptions& options,
                              std::span<uint32_t> counts) const {
  StopPoll stop(options.stopped);
  CountCollector::Storage storage;
  for (size_t i = 0; i < rays.size(); ++i) {
    CountCollector collector(triangles_, rays[i], options, stop, &storage);
    Collect(rays[i], collector);
    counts[i] = collector.Count();
  }
}

}  // namespace deltaray
