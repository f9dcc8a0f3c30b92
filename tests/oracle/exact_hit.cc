#include "tests/oracle/exact_hit.h"

#include "tests/oracle/products.h"

namespace deltaray {
namespace {

using Vec3x = Vec3<Dyadic>;

Vec3x ToExact(Vec3f a) { return {Dyadic(a.x), Dyadic(a.y), Dyadic(a.z)}; }

// Six times the volume that the three span.
Dyadic Volume(const Vec3x& a, const Vec3x& b, const Vec3x& c) { return DotProduct(a, CrossProduct(b, c)); }

}  // namespace

std::optional<ExactHit> FindExactHit(const Ray& ray, const Triangle& triangle) {
  const Vec3x o = ToExact(ray.origin), d = ToExact(ray.direction);
  const Vec3x a = ToExact(triangle.v0) - o, b = ToExact(triangle.v1) - o, c = ToExact(triangle.v2) - o;
  // Six times the volume that d spans with each edge: the weights of the corner opposite to it in the point of the
  // triangle's plane that the line meets. Their sum is that of d with the triangle; 0 where they are parallel.
  Dyadic a_weight = Volume(d, b, c), b_weight = Volume(d, c, a), c_weight = Volume(d, a, b);
  Dyadic sum = a_weight + b_weight + c_weight;
  if (sum.Sign() == 0) return std::nullopt;
  // The volume that the origin spans with the triangle.
  Dyadic volume = Volume(a, b, c);

  ExactHit hit;
  // sum = d · normal, and corners in counter-clockwise order are seen from where the normal points.
  hit.back = sum.Sign() > 0;
  if (!hit.back) {
    a_weight = -a_weight;
    b_weight = -b_weight;
    c_weight = -c_weight;
    sum = -sum;
    volume = -volume;
  }
  if (a_weight.Sign() < 0 || b_weight.Sign() < 0 || c_weight.Sign() < 0) return std::nullopt;
  hit.t = {volume, sum};
  if (Compare(hit.t, ray.t_min) < 0 || Compare(hit.t, ray.t_max) > 0) return std::nullopt;
  hit.u = {b_weight, sum};
  hit.v = {c_weight, sum};
  return hit;
}

}  // namespace deltaray
