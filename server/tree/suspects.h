// The end of an exact query: which of the triangles that a ray may hit are hit, and where.

#ifndef SERVER_TREE_SUSPECTS_H_
#define SERVER_TREE_SUSPECTS_H_

#include <cstdint>
#include <span>
#include <vector>

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

  // Empties the ray's list of suspects, keeping the closest hit among them in mind, and returns its new limit.
  float DecideEarly(RaySlot& ray);
  // Whether the list has all that the ray may hit.
  bool KnowsAll(const RaySlot& ray) const;
  // Writes the ray's hit.
  void Decide(const RaySlot& ray);
  // Writes the hit of a ray that can hit one primitive only.
  void DecideOne(uint32_t ray, uint32_t primitive);

 private:
  struct Early {
    uint32_t ray, primitive;
  };

  // Looks at all suspects and at the closest one of those decided early.
  void VisitAll(const RaySlot& ray, Collector& collector);

  const WideScene& scene_;
  const std::span<const Ray> rays_;
  const QueryOptions& options_;
  const std::span<Hit> hits_;
  std::vector<Early> early_;  // of rays in flight: few
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
  // Writes the ray's answer.
  void End(RaySlot& ray) { any_[ray.ray] = ray.primitive != kNoPrimitive || DecideEarly(ray); }

 private:
  const WideScene& scene_;
  const std::span<const Ray> rays_;
  const QueryOptions& options_;
  const std::span<uint8_t> any_;
};

}  // namespace deltaray

#endif  // SERVER_TREE_SUSPECTS_H_
