// How wrong an answer is.

#ifndef TESTS_ORACLE_JUDGE_H_
#define TESTS_ORACLE_JUDGE_H_

#include <cstdint>
#include <optional>
#include <string>

#include "server/geometry/ray.h"
#include "tests/oracle/oracle.h"

namespace deltaray {

enum class Verdict : uint8_t {
  kRight,           // hit or miss, and the primitive, are the exact ones
  kFalseMiss,       // there is a hit
  kFalseHit,        // there is none
  kWrongSurface,    // a primitive that is hit elsewhere, or not at all
  kWrongPrimitive,  // another one that is hit at the same exact t
};

// Of the primitive answered for the closest hit of `ray` (kNoPrimitive: a miss), whose right answer is `truth`.
Verdict Judge(const Oracle& oracle, const Ray& ray, const std::optional<OracleHit>& truth, uint32_t primitive);

// Whether an answer, of a closest hit or of one of all, is right at AccuracyLevel::kExact: all of it, to the bit. A
// miss has an infinite t and zeros.
bool IsRight(const std::optional<OracleHit>& truth, const Hit& hit);

// The ray, the truth and the answer, for the message of a failed test: floats as hexadecimal, so that none is rounded.
std::string Describe(const Ray& ray, const std::optional<OracleHit>& truth, const Hit& hit);

// Floats between two of them: 0 for equal ones, +0 and -0 among them. REQUIRES: neither is NaN.
uint32_t StepsApart(float a, float b);

}  // namespace deltaray

#endif  // TESTS_ORACLE_JUDGE_H_
