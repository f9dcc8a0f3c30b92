#include "server/tree/suspects.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

namespace deltaray {

uint32_t PrimitiveOf(const WideScene& scene, const Suspect& suspect) {
  const ChildRef leaf(suspect.leaf);
  const std::byte* const data = scene.arrays.block.data() + leaf.offset() * UnitBytes(Width(scene.arrays.target));
  uint32_t id;
  std::memcpy(&id, data + (kIdColumn * leaf.triangles() + suspect.lane) * sizeof(id), sizeof(id));
  return id & kPrimitiveMask;
}

float LimitInFrame(const RaySlot& ray, double limit) {
  const float rounded = static_cast<float>(limit / ray.t_unscale);
  return std::min(ray.limit, std::nextafter(rounded, std::numeric_limits<float>::infinity()));
}

void DropNeedless(const WideScene& scene, RaySlot& ray) {
  uint32_t kept = 0;
  uint32_t primitives[RaySlot::kMaxSuspects];
  for (uint32_t i = 0; i < ray.suspect_count; ++i) {
    if (ray.suspect_t[i] > ray.limit) continue;
    const uint32_t primitive = PrimitiveOf(scene, ray.suspects[i]);
    if (std::find(primitives, primitives + kept, primitive) != primitives + kept) continue;
    primitives[kept] = primitive;
    ray.suspect_t[kept] = ray.suspect_t[i];
    ray.suspects[kept] = ray.suspects[i];
    ++kept;
  }
  ray.suspect_count = kept;
}

void ClosestDecider::VisitAll(const RaySlot& ray, Collector& collector) const {
  if (ray.primitive != kNoPrimitive) collector.Visit(ray.primitive);
  for (uint32_t i = 0; i < ray.suspect_count; ++i) collector.Visit(PrimitiveOf(scene_, ray.suspects[i]));
}

float ClosestDecider::DecideEarly(RaySlot& ray) {
  ClosestCollector collector(scene_.triangles, rays_[ray.ray], options_, scene_.stop);
  VisitAll(ray, collector);
  ray.suspect_count = 0;
  if (collector.primitive() == kNoPrimitive) return ray.limit;
  ray.primitive = collector.primitive();
  return LimitInFrame(ray, collector.limit());
}

void ClosestDecider::Decide(const RaySlot& ray) {
  ClosestCollector collector(scene_.triangles, rays_[ray.ray], options_, scene_.stop);
  VisitAll(ray, collector);
  hits_[ray.ray] = collector.hit();
}

void ClosestDecider::DecideOne(uint32_t ray, uint32_t primitive) {
  ClosestCollector collector(scene_.triangles, rays_[ray], options_, scene_.stop);
  collector.Visit(primitive);
  hits_[ray] = collector.hit();
}

bool AnyDecider::DecideEarly(RaySlot& ray) {
  AnyCollector collector(scene_.triangles, rays_[ray.ray], options_, scene_.stop);
  for (uint32_t i = 0; i < ray.suspect_count; ++i) collector.Visit(PrimitiveOf(scene_, ray.suspects[i]));
  ray.suspect_count = 0;
  return collector.any();
}

}  // namespace deltaray
