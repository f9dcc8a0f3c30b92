#include "tests/oracle/judge.h"

#include <bit>
#include <cmath>
#include <limits>

#include "absl/strings/str_format.h"

namespace deltaray {

Verdict Judge(const Oracle& oracle, const Ray& ray, const std::optional<OracleHit>& truth, uint32_t primitive) {
  if (!truth) return primitive == kNoPrimitive ? Verdict::kRight : Verdict::kFalseHit;
  if (primitive == kNoPrimitive) return Verdict::kFalseMiss;
  if (primitive == truth->primitive) return Verdict::kRight;
  return oracle.CompareT(ray, primitive, truth->primitive) == 0 ? Verdict::kWrongPrimitive : Verdict::kWrongSurface;
}

bool IsRight(const std::optional<OracleHit>& truth, const Hit& hit) {
  // Unlike ==, tells +0 from -0.
  const auto same = [](float a, float b) { return std::bit_cast<uint32_t>(a) == std::bit_cast<uint32_t>(b); };
  if (!truth) {
    return !hit.IsHit() && same(hit.t, std::numeric_limits<float>::infinity()) && same(hit.u, 0) && same(hit.v, 0) &&
           !hit.back;
  }
  return hit.primitive == truth->primitive && hit.back == truth->back && same(hit.t, truth->t) &&
         same(hit.u, truth->rounded_u) && same(hit.v, truth->rounded_v);
}

std::string Describe(const Ray& ray, const std::optional<OracleHit>& truth, const Hit& hit) {
  const OracleHit right = truth.value_or(OracleHit());
  return absl::StrFormat(
      "origin (%a, %a, %a) direction (%a, %a, %a) t [%a, %a] excluded %u\n  right: primitive %u t %a u %.9g v %.9g "
      "back %d\n  found: primitive %u t %a u %.9g v %.9g back %d",
      ray.origin.x, ray.origin.y, ray.origin.z, ray.direction.x, ray.direction.y, ray.direction.z, ray.t_min, ray.t_max,
      ray.excluded_primitive, right.primitive, right.t, right.u, right.v, right.back, hit.primitive, hit.t, hit.u,
      hit.v, hit.back);
}

uint32_t StepsApart(float a, float b) {
  // Numbered by size: the bits of a float without its sign grow with its magnitude.
  const auto number = [](float x) {
    const auto magnitude = static_cast<int64_t>(std::bit_cast<uint32_t>(x) & 0x7FFFFFFF);
    return std::signbit(x) ? -magnitude : magnitude;
  };
  const int64_t steps = number(a) - number(b);
  return static_cast<uint32_t>(steps < 0 ? -steps : steps);
}

}  // namespace deltaray
