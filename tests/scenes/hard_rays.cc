#include "tests/scenes/hard_rays.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>

#include "tests/scenes/random.h"
#include "tests/scenes/rays.h"

namespace deltaray {
namespace {

constexpr float kMaxFloat = std::numeric_limits<float>::max();

float ClampToFloat(double x) {
  return static_cast<float>(std::clamp(x, -static_cast<double>(kMaxFloat), static_cast<double>(kMaxFloat)));
}
Vec3f ClampToFloat(Vec3d v) { return {ClampToFloat(v.x), ClampToFloat(v.y), ClampToFloat(v.z)}; }

// Picks points on a mesh, and places about it.
class Sampler {
 public:
  Sampler(const TriangleMesh& mesh, uint64_t seed) : mesh_(mesh), random_(seed), bounds_(MeshBounds(mesh)) {
    const Vec3d size = static_cast<Vec3d>(bounds_.max) - static_cast<Vec3d>(bounds_.min);
    size_ = std::max({size.x, size.y, size.z});
    if (size_ == 0) size_ = 1;
  }

  Random& random() { return random_; }
  double size() const { return size_; }

  std::array<Vec3d, 3> PickTriangle() {
    const Triangle t = mesh_.triangles()[random_.Below(static_cast<uint32_t>(mesh_.indices.size()))];
    return {static_cast<Vec3d>(t.v0), static_cast<Vec3d>(t.v1), static_cast<Vec3d>(t.v2)};
  }
  Vec3d PickVertex() { return PickTriangle()[random_.Below(3)]; }
  Vec3d PickOnEdge() {
    const auto corners = PickTriangle();
    const uint32_t edge = random_.Below(3);
    // Halves and quarters are often exact in float, other fractions seldom.
    const double s = random_.Below(2) == 0 ? 0.25 * (1 + random_.Below(3)) : random_.Uniform();
    return corners[edge] + s * (corners[(edge + 1) % 3] - corners[edge]);
  }
  Vec3d PickInside() {
    const auto [a, b, c] = PickTriangle();
    const double u = random_.Uniform(), v = random_.Uniform(0, 1 - u);
    return a + u * (b - a) + v * (c - a);
  }
  // A place in the box of thrice the mesh's size about it.
  Vec3d PickAround() {
    const Vec3d centre = 0.5 * (static_cast<Vec3d>(bounds_.min) + static_cast<Vec3d>(bounds_.max));
    return centre + 1.5 * size_ * (2.0 * random_.InUnitBox() - Vec3d{1, 1, 1});
  }

 private:
  const TriangleMesh& mesh_;
  Random random_;
  Bounds bounds_;
  double size_ = 1;
};

// From `origin` towards `target`, as float tells them: t is about `length` times what it would be at unit speed.
Ray Aim(Vec3d origin, Vec3d target, double speed = 1) {
  Ray ray;
  ray.origin = ClampToFloat(origin);
  const Vec3d way = target - static_cast<Vec3d>(ray.origin);
  const double longest = std::max({std::abs(way.x), std::abs(way.y), std::abs(way.z)});
  // As it stands the difference is exact more often than once it is normalised; but it must not overflow or vanish.
  const bool as_it_stands = speed == 1 && longest > 1e-30 && longest < 1e30;
  ray.direction = ClampToFloat(as_it_stands || longest == 0 ? way : (speed / longest) * way);
  return ray;
}

template <typename MakeRay>
std::vector<Ray> MakeRays(const TriangleMesh& mesh, uint32_t count, uint64_t seed, MakeRay make_ray) {
  Sampler sampler(mesh, seed);
  std::vector<Ray> rays;
  rays.reserve(count);
  for (uint32_t i = 0; i < count; ++i) rays.push_back(make_ray(sampler, i));
  return rays;
}

std::vector<Ray> AtVertices(const TriangleMesh& mesh, uint32_t count, uint64_t seed) {
  return MakeRays(mesh, count, seed, [](Sampler& s, uint32_t) {
    const Vec3d target = s.PickVertex();
    return Aim(s.PickAround(), target);
  });
}

std::vector<Ray> AtEdges(const TriangleMesh& mesh, uint32_t count, uint64_t seed) {
  return MakeRays(mesh, count, seed, [](Sampler& s, uint32_t) {
    const Vec3d target = s.PickOnEdge();
    return Aim(s.PickAround(), target);
  });
}

// Two coordinates of the origin are those of vertices, so that the ray runs in faces of boxes, and in kd planes.
std::vector<Ray> AlongAxes(const TriangleMesh& mesh, uint32_t count, uint64_t seed) {
  return MakeRays(mesh, count, seed, [](Sampler& s, uint32_t i) {
    const int axis = static_cast<int>(i % 3);
    Vec3d origin = s.PickVertex();
    const Vec3d other = s.random().Below(2) == 0 ? s.PickVertex() : s.PickAround();
    origin[(axis + 1) % 3] = other[(axis + 1) % 3];
    if (s.random().Below(2) == 0) origin[axis] = s.PickAround()[axis];
    Ray ray;
    ray.origin = ClampToFloat(origin);
    for (int a = 0; a < 3; ++a) ray.direction[a] = s.random().Below(2) == 0 ? 0.0f : -0.0f;
    ray.direction[axis] = s.random().Below(2) == 0 ? 1.0f : -1.0f;
    // Half of them start behind the mesh, so that all of it is before them.
    if (i % 2 == 0) ray.origin[axis] = ClampToFloat(origin[axis] - 4 * s.size() * ray.direction[axis]);
    return ray;
  });
}

// In an axis-parallel plane through vertices: one component of the direction is zero.
std::vector<Ray> InAxisPlanes(const TriangleMesh& mesh, uint32_t count, uint64_t seed) {
  return MakeRays(mesh, count, seed, [](Sampler& s, uint32_t i) {
    const int axis = static_cast<int>(i % 3);
    const Vec3d target = s.PickVertex();
    Vec3d origin = s.PickAround();
    origin[axis] = target[axis];
    Ray ray = Aim(origin, target);
    ray.direction[axis] = i % 2 == 0 ? 0.0f : -0.0f;
    return ray;
  });
}

std::vector<Ray> FromSurface(const TriangleMesh& mesh, uint32_t count, uint64_t seed) {
  return MakeRays(mesh, count, seed, [](Sampler& s, uint32_t i) {
    const Vec3d origin = i % 3 == 0 ? s.PickVertex() : i % 3 == 1 ? s.PickOnEdge() : s.PickInside();
    const Vec3d target = s.random().Below(2) == 0 ? s.PickInside() : s.PickAround();
    return Aim(origin, target);
  });
}

std::vector<Ray> FromAfar(const TriangleMesh& mesh, uint32_t count, uint64_t seed) {
  return MakeRays(mesh, count, seed, [](Sampler& s, uint32_t) {
    const Vec3d target = s.PickInside();
    const double sizes = s.random().LogUniform(1e3, 1e9);
    return Aim(target + sizes * s.size() * s.random().OnUnitSphere(), target);
  });
}

std::vector<Ray> AtAllSpeeds(const TriangleMesh& mesh, uint32_t count, uint64_t seed) {
  return MakeRays(mesh, count, seed, [](Sampler& s, uint32_t) {
    const Vec3d target = s.PickInside();
    const Vec3d origin = s.PickAround();
    return Aim(origin, target, s.random().LogUniform(1e-20, 1e20));
  });
}

// Intervals that begin behind the origin, are one point, are empty, or end at a vertex; directions of no length.
std::vector<Ray> OddIntervals(const TriangleMesh& mesh, uint32_t count, uint64_t seed) {
  return MakeRays(mesh, count, seed, [](Sampler& s, uint32_t i) {
    const Vec3d target = i % 2 == 0 ? s.PickVertex() : s.PickInside();
    Ray ray = Aim(s.PickAround(), target);
    switch (i % 6) {
      case 0:
        ray.t_max = 1;
        break;
      case 1:
        ray.t_min = -std::numeric_limits<float>::infinity();
        break;
      case 2:
        ray.t_min = ray.t_max = 1;
        break;
      case 3:
        ray.t_min = -2;
        ray.t_max = static_cast<float>(s.random().Uniform(-1, 2));
        break;
      case 4:
        ray.t_min = 1;
        break;
      default:
        ray.direction = {0.0f, -0.0f, 0.0f};
    }
    return ray;
  });
}

// Origin and end are in the plane of one triangle: exactly, where its corners are small integers; else within rounding
// of it.
std::vector<Ray> InPlanes(const TriangleMesh& mesh, uint32_t count, uint64_t seed) {
  return MakeRays(mesh, count, seed, [](Sampler& s, uint32_t) {
    const auto [a, b, c] = s.PickTriangle();
    const auto steps = [&] { return static_cast<double>(s.random().Below(6)) - 2; };
    const auto pick = [&, a = a, e1 = b - a, e2 = c - a] {
      const double i = steps(), j = steps();
      return a + i * e1 + j * e2;
    };
    const Vec3d origin = pick(), target = pick();
    return Aim(origin, target);
  });
}

// Along an axis but for components that are smaller by up to all that float can tell.
std::vector<Ray> NearlyAlongAxes(const TriangleMesh& mesh, uint32_t count, uint64_t seed) {
  std::vector<Ray> rays = AlongAxes(mesh, count, seed);
  Random random(seed + 1);
  for (Ray& ray : rays) {
    for (int axis = 0; axis < 3; ++axis) {
      if (ray.direction[axis] != 0 || random.Below(4) == 0) continue;
      const double part = random.LogUniform(1e-44, 1e-3);
      ray.direction[axis] = static_cast<float>(random.Below(2) == 0 ? part : -part);
    }
  }
  return rays;
}

// A float of random bits, but not infinite or NaN.
float AnyFloat(Random& random) {
  while (true) {
    const auto x = std::bit_cast<float>(random.Below(0xFFFFFFFF));
    if (std::isfinite(x)) return x;
  }
}
Vec3f AnyVector(Random& random) {
  const float x = AnyFloat(random), y = AnyFloat(random), z = AnyFloat(random);
  return {x, y, z};
}

// Origins of random bits; directions likewise, or towards the mesh; intervals likewise, or everything before the
// origin.
std::vector<Ray> OfAnyBits(const TriangleMesh& mesh, uint32_t count, uint64_t seed) {
  return MakeRays(mesh, count, seed, [](Sampler& s, uint32_t i) {
    Ray ray;
    ray.origin = AnyVector(s.random());
    ray.direction = i % 2 == 0 ? AnyVector(s.random()) : Aim(static_cast<Vec3d>(ray.origin), s.PickInside()).direction;
    if (i % 4 < 2) return ray;
    ray.t_min = AnyFloat(s.random());
    ray.t_max = AnyFloat(s.random());
    return ray;
  });
}

constexpr HardRays kFamilies[] = {
    {"at_vertices", AtVertices},    {"at_edges", AtEdges},
    {"along_axes", AlongAxes},      {"in_axis_planes", InAxisPlanes},
    {"from_surface", FromSurface},  {"from_afar", FromAfar},
    {"at_all_speeds", AtAllSpeeds}, {"odd_intervals", OddIntervals},
    {"in_planes", InPlanes},        {"nearly_along_axes", NearlyAlongAxes},
    {"of_any_bits", OfAnyBits},
};

}  // namespace

std::span<const HardRays> HardRayFamilies() { return kFamilies; }

std::vector<Ray> RaysEndingAtHits(const Tree& tree, std::span<const Ray> rays) {
  std::vector<Hit> hits(rays.size());
  tree.ClosestHits(rays, {}, hits);
  std::vector<Ray> result;
  for (size_t i = 0; i < rays.size(); ++i) {
    if (!hits[i].IsHit()) continue;
    result.push_back(rays[i]);
    result.back().t_max = hits[i].t;
    result.push_back(rays[i]);
    result.back().t_min = hits[i].t;
    result.push_back(rays[i]);
    result.back().excluded_primitive = hits[i].primitive;
  }
  return result;
}

}  // namespace deltaray
