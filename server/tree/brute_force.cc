#include "server/tree/brute_force.h"

namespace deltaray {

void BruteForce::Traverse(const Ray&, Collector& collector) const {
  for (uint32_t primitive = 0; primitive < triangles().size() && !collector.IsDone(); ++primitive) {
    collector.Visit(primitive);
  }
}

TreeShape BruteForce::Shape() const {
  const size_t size = triangles().size();
  if (size == 0) return {};
  return {.nodes = 1, .leaves = 1, .references = size, .sah_cost = static_cast<double>(size)};
}

}  // namespace deltaray
