#include "tests/scenes/rays.h"

#include <cmath>
#include <numbers>

#include "tests/scenes/random.h"
#include "tests/scenes/shapes.h"

namespace deltaray {
namespace {

Vec3d Normalized(Vec3d v) { return (1 / Length(v)) * v; }

// The sphere round a box; of radius 1 where the box is a point.
struct BoundingSphere {
  explicit BoundingSphere(const Bounds& bounds) {
    const auto min = static_cast<Vec3d>(bounds.min), max = static_cast<Vec3d>(bounds.max);
    centre = 0.5 * (min + max);
    if (min != max) radius = 0.5 * Length(max - min);
  }
  Vec3d centre;
  double radius = 1;
};

struct SurfacePoint {
  Vec3d position;
  Vec3d normal;  // of length 1, towards the viewer
  double distance = 0;
};

std::vector<SurfacePoint> HitPoints(const TriangleMesh& mesh, const Tree& tree, const std::vector<Ray>& rays) {
  std::vector<Hit> hits(rays.size());
  tree.ClosestHits(rays, {}, hits);
  std::vector<SurfacePoint> points;
  for (size_t i = 0; i < rays.size(); ++i) {
    if (!hits[i].IsHit()) continue;
    const auto direction = static_cast<Vec3d>(rays[i].direction);
    const Triangle triangle = mesh.triangles()[hits[i].primitive];
    const auto v0 = static_cast<Vec3d>(triangle.v0);
    Vec3d normal = Normalized(Cross(static_cast<Vec3d>(triangle.v1) - v0, static_cast<Vec3d>(triangle.v2) - v0));
    if (Dot(normal, direction) > 0) normal = -1.0 * normal;
    const double t = hits[i].t;
    points.push_back({static_cast<Vec3d>(rays[i].origin) + t * direction, normal, t * Length(direction)});
  }
  return points;
}

}  // namespace

std::vector<Ray> CameraRays(const Bounds& bounds, uint32_t width, uint32_t height) {
  const BoundingSphere sphere(bounds);
  const Vec3d back = Normalized(Vec3d{0.3, 0.25, 1});
  const Vec3d right = Normalized(Cross(Vec3d{0, 1, 0}, back));
  const Vec3d up = Cross(back, right);
  // The sphere just fits the field of view of 40 degrees, whichever side of the picture is shorter.
  constexpr double kHalfAngle = 20 * std::numbers::pi / 180;
  const double extent = std::tan(kHalfAngle);
  const double shorter = std::min(width, height);
  const auto origin = static_cast<Vec3f>(sphere.centre + (sphere.radius / std::sin(kHalfAngle)) * back);

  std::vector<Ray> rays;
  rays.reserve(static_cast<size_t>(width) * height);
  for (uint32_t y = 0; y < height; ++y) {
    for (uint32_t x = 0; x < width; ++x) {
      const double sx = extent * (2.0 * x + 1 - width) / shorter;
      const double sy = extent * (height - 2.0 * y - 1) / shorter;
      Ray& ray = rays.emplace_back();
      ray.origin = origin;
      ray.direction = static_cast<Vec3f>(sx * right + sy * up - back);
    }
  }
  return rays;
}

std::vector<Ray> ChordRays(const Bounds& bounds, uint32_t count, uint64_t seed) {
  const BoundingSphere sphere(bounds);
  Random random(seed);
  std::vector<Ray> rays(count);
  for (Ray& ray : rays) {
    const Vec3d from = random.OnUnitSphere(), to = random.OnUnitSphere();
    ray.origin = static_cast<Vec3f>(sphere.centre + sphere.radius * from);
    ray.direction = static_cast<Vec3f>(to - from);
  }
  return rays;
}

std::vector<Ray> BounceRays(const TriangleMesh& mesh, const Tree& tree, const std::vector<Ray>& rays, uint64_t seed) {
  Random random(seed);
  std::vector<Ray> bounces;
  for (const SurfacePoint& point : HitPoints(mesh, tree, rays)) {
    // A point of the unit sphere that touches the surface is cosine-distributed as seen from where it touches.
    Ray& ray = bounces.emplace_back();
    ray.origin = static_cast<Vec3f>(point.position);
    ray.direction = static_cast<Vec3f>(point.normal + random.OnUnitSphere());
    ray.t_min = static_cast<float>(1e-4 * point.distance);
  }
  for (size_t i = bounces.size(); i > 1; --i)
    std::swap(bounces[i - 1], bounces[random.Below(static_cast<uint32_t>(i))]);
  return bounces;
}

std::vector<Ray> ShadowRays(const TriangleMesh& mesh, const Tree& tree, const std::vector<Ray>& rays) {
  const BoundingSphere sphere(MeshBounds(mesh));
  const Vec3d light = sphere.centre + 2 * sphere.radius * Normalized(Vec3d{0.4, 1, 0.6});
  std::vector<Ray> shadows;
  for (const SurfacePoint& point : HitPoints(mesh, tree, rays)) {
    Ray& ray = shadows.emplace_back();
    ray.origin = static_cast<Vec3f>(point.position);
    ray.direction = static_cast<Vec3f>(light - point.position);
    ray.t_min = 1e-4f;
    ray.t_max = 1;
  }
  return shadows;
}

Bounds MeshBounds(const TriangleMesh& mesh) {
  Bounds bounds;
  for (size_t i = 0; i < mesh.indices.size(); ++i) bounds.Extend(mesh.triangles()[i].GetBounds());
  return mesh.indices.empty() ? Bounds{{0, 0, 0}, {0, 0, 0}} : bounds;
}

}  // namespace deltaray
