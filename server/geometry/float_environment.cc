#include "server/geometry/float_environment.h"

#include <cfenv>
#include <limits>

namespace deltaray {
namespace {

// Volatile, so that it is the running processor that works the results out, and not the compiler.
template <typename T>
const char* Fault() {
  using Limits = std::numeric_limits<T>;
  const volatile T one = 1, epsilon = Limits::epsilon(), least_normal = Limits::min(), least = Limits::denorm_min();
  const volatile T quarter = one + epsilon / 4, minus_quarter = -one - epsilon / 4, most = one + epsilon * 3 / 4;
  if (quarter != one || minus_quarter != -one || most == one) return "it does not round to nearest";
  const volatile T normal = least / epsilon;
  if (normal == 0) return "numbers that are subnormal count as 0 (denormals are zero)";
  const volatile T subnormal = least_normal / 2;
  if (subnormal == 0) return "results that are subnormal become 0 (flush to zero)";
  return nullptr;
}

}  // namespace

const char* FloatEnvironmentFault() {
  // The mode by its name is what the library's functions look at; arithmetic may have another one of its own.
  if (std::fegetround() != FE_TONEAREST) return "it does not round to nearest";
  const char* const fault = Fault<float>();
  return fault != nullptr ? fault : Fault<double>();
}

}  // namespace deltaray
