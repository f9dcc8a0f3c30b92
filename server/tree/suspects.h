// The end of an exact query: which of the triangles that a ray may hit are hit, and where.

#ifndef SERVER_TREE_SUSPECTS_H_
#define SERVER_TREE_SUSPECTS_H_

#include <cstdint>
#include <span>

#include "server/geometry/ray.h"
#include "server/tree/collector.h"
#include "server/tree/ray_kernels.h"
#include "server/tree/ray_slot.h"

namespace deltaray {

// The primitive of a suspect.
uint32_t PrimitiveOf(const WideScene& scene, const Suspect& suspect);

// A float in the tree's frame that is at least `limit`, an upper bound of a t of the ray, and not above ray.limit.
float LimitInFrame(const RaySlot& ray, double limit);

// Drops suspects whose t is for certain greater than that of a certain hit, and repeated ones.
void DropNeedless(const WideScene& scene, RaySlot& ray);

// Decides closest hits, one by one. One object a batch.
class ClosestDecider {
 public:
  ClosestDecider(const WideScene& scene, std::span<const Ray> rays, const QueryOptions& options, std::span<Hit> hits)
      : scene_(scene), rays_(rays), options_(options), hits_(hits) {}

  // Empties the ray's list of suspects, keeping the closest hit among them as ray.primitive, and returns its new limit.
  float DecideEarly(RaySlot& ray);
  // Writes the ray's hit.
  void Decide(const RaySlot& ray);
  // Writes the hit of a ray that can hit one primitive only.
  void DecideOne(uint32_t ray, uint32_t primitive);

 private:
  // Looks at all suspects, and at the closest one of those decided early.
  void VisitAll(const RaySlot& ray, Collector& collector) const;

  const WideScene& scene_;
  const std::span<const Ray> rays_;
  const QueryOptions& options_;
  const std::span<Hit> hits_;
};

// Decides whether there is a hit. One object a batch.
class AnyDecider {
 public:
  AnyDecider(const WideScene& scene, std::span<const Ray> rays, const QueryOptions& options, std::span<uint8_t> any)
      : scene_(scene), rays_(rays), options_(options), any_(any) {}

  // Empties the ray's list of suspects; returns whether one of them is hit.
  bool DecideEarly(RaySlot& ray);
  // Writes a miss.
  void Miss(uint32_t ray) { any_[ray] = 0; }
  // Writes the answer of a ray that may hit something.
  void End(RaySlot& ray) { any_[ray.ray] = ray.primitive != kNoPrimitive || DecideEarly(ray); }

 private:
  const WideScene& scene_;
  const std::span<const Ray> rays_;
  const QueryOptions& options_;
  const std::span<uint8_t> any_;
};

}  // namespace deltaray

#endif  // SERVER_TREE_SUSPECTS_H_
