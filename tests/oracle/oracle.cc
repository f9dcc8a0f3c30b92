#include "tests/oracle/oracle.h"

#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <utility>

#include "tests/oracle/exact_hit.h"

namespace deltaray {
namespace {

struct Found {
  ExactHit hit;
  Possible bounds;

  OracleHit Rounded() const {
    return {.t = RoundToFloat(hit.t),
            .rounded_u = RoundToFloat(hit.u),
            .rounded_v = RoundToFloat(hit.v),
            .u = Approximate(hit.u),
            .v = Approximate(hit.v),
            .primitive = bounds.primitive,
            .back = hit.back};
  }
};

bool IsBefore(const Found& a, const Found& b) {
  if (a.bounds.t_upper < b.bounds.t_lower) return true;
  if (b.bounds.t_upper < a.bounds.t_lower) return false;
  const int order = Compare(a.hit.t, b.hit.t);
  return order != 0 ? order < 0 : a.bounds.primitive < b.bounds.primitive;
}

bool IsCulled(const ExactHit& hit, Culling culling) {
  return culling == Culling::kBack ? hit.back : culling == Culling::kFront && !hit.back;
}

// The exact hit of a triangle that may be one.
std::optional<Found> Decide(const Ray& ray, const TrianglesView& triangles, const Possible& possible, Culling culling) {
  if (possible.primitive == ray.excluded_primitive) return std::nullopt;
  std::optional<ExactHit> hit = FindExactHit(ray, triangles[possible.primitive]);
  if (!hit || IsCulled(*hit, culling)) return std::nullopt;
  return Found{*std::move(hit), possible};
}

}  // namespace

Oracle::Oracle(TrianglesView triangles) : triangles_(triangles), filter_(triangles) {}

std::optional<OracleHit> Oracle::ClosestHit(const Ray& ray, Culling culling) const {
  std::vector<Possible> possible;
  filter_.Find(ray, &possible);
  std::ranges::sort(possible, {}, &Possible::t_lower);
  std::optional<Found> closest;
  for (const Possible& p : possible) {
    if (closest && p.t_lower > closest->bounds.t_upper) break;
    std::optional<Found> found = Decide(ray, triangles_, p, culling);
    if (found && (!closest || IsBefore(*found, *closest))) closest = std::move(found);
  }
  if (!closest) return std::nullopt;
  return closest->Rounded();
}

std::vector<OracleHit> Oracle::AllHits(const Ray& ray, Culling culling) const {
  std::vector<Possible> possible;
  filter_.Find(ray, &possible);
  std::vector<Found> found;
  for (const Possible& p : possible) {
    if (std::optional<Found> hit = Decide(ray, triangles_, p, culling)) found.push_back(*std::move(hit));
  }
  std::ranges::sort(found, IsBefore);
  std::vector<OracleHit> hits;
  for (const Found& f : found) hits.push_back(f.Rounded());
  return hits;
}

std::vector<std::optional<OracleHit>> Oracle::ClosestHits(std::span<const Ray> rays, Culling culling) const {
  std::vector<std::optional<OracleHit>> hits(rays.size());
  // In an arena of its own: what the process' has of the caller's floating-point settings, its first user decided, and
  // Embree builds with subnormal numbers flushed to zero.
  tbb::task_arena().execute(
      [&] { tbb::parallel_for(size_t{0}, rays.size(), [&](size_t i) { hits[i] = ClosestHit(rays[i], culling); }); });
  return hits;
}

std::optional<int> Oracle::CompareT(const Ray& ray, uint32_t a, uint32_t b) const {
  const std::optional<ExactHit> first = FindExactHit(ray, triangles_[a]), second = FindExactHit(ray, triangles_[b]);
  if (!first || !second) return std::nullopt;
  return Compare(first->t, second->t);
}

}  // namespace deltaray
