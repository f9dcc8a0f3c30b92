#include "tests/oracle/judge.h"

#include <bit>
#include <cmath>

namespace deltaray {

Verdict Judge(const Oracle& oracle, const Ray& ray, const std::optional<OracleHit>& truth, uint32_t primitive) {
  if (!truth) return primitive == kNoPrimitive ? Verdict::kRight : Verdict::kFalseHit;
  if (primitive == kNoPrimitive) return Verdict::kFalseMiss;
  if (primitive == truth->primitive) return Verdict::kRight;
  return oracle.CompareT(ray, primitive, truth->primitive) == 0 ? Verdict::kWrongPrimitive : Verdict::kWrongSurface;
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
