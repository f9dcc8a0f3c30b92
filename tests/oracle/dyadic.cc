#include "tests/oracle/dyadic.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>

namespace deltaray {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

// Where numbers round to `f`, at or above 0, and where to the next float up, part: half way, and for the greatest
// float where it would be half way to one more.
double UpperMidpoint(float f) {
  const float next = std::nextafter(f, kInfinity);
  return std::isinf(next) ? 0x1p128 - 0x1p103 : (static_cast<double>(f) + static_cast<double>(next)) / 2;
}

bool IsOdd(float f) { return (std::bit_cast<uint32_t>(f) & 1) != 0; }

}  // namespace

Dyadic::Dyadic(double x) {
  // A fraction of 53 bits.
  mantissa_ = static_cast<int64_t>(std::ldexp(std::frexp(x, &exponent_), 53));
  exponent_ -= 53;
}

double Dyadic::Approximate(int* exponent) const {
  *exponent = exponent_;
  if (mantissa_.is_zero()) return 0;
  const Integer magnitude = abs(mantissa_);
  const int dropped = std::max(0, static_cast<int>(msb(magnitude)) - 63);
  *exponent += dropped;
  const auto leading = static_cast<double>(static_cast<uint64_t>(magnitude >> dropped));
  return mantissa_ < 0 ? -leading : leading;
}

Dyadic operator+(const Dyadic& a, const Dyadic& b) {
  if (a.mantissa_.is_zero()) return b;
  if (b.mantissa_.is_zero()) return a;
  // The one of the greater exponent is brought to the other's.
  if (a.exponent_ > b.exponent_) return {(a.mantissa_ << (a.exponent_ - b.exponent_)) + b.mantissa_, b.exponent_};
  return {a.mantissa_ + (b.mantissa_ << (b.exponent_ - a.exponent_)), a.exponent_};
}

Dyadic Dyadic::operator-() const { return {-mantissa_, exponent_}; }
Dyadic operator-(const Dyadic& a, const Dyadic& b) { return a + -b; }
Dyadic operator*(const Dyadic& a, const Dyadic& b) { return {a.mantissa_ * b.mantissa_, a.exponent_ + b.exponent_}; }

int Compare(const Quotient& a, const Quotient& b) {
  return (a.numerator * b.denominator - b.numerator * a.denominator).Sign();
}

int Compare(const Quotient& a, double b) {
  if (std::isinf(b)) return b > 0 ? -1 : 1;
  return (a.numerator - a.denominator * Dyadic(b)).Sign();
}

double Approximate(const Quotient& a) {
  int up, down;
  const double numerator = a.numerator.Approximate(&up), denominator = a.denominator.Approximate(&down);
  return std::ldexp(numerator / denominator, up - down);
}

float RoundToFloat(const Quotient& a) {
  if (a.numerator.Sign() == 0) return 0;
  if (a.numerator.Sign() < 0) {
    const float rounded = RoundToFloat({-a.numerator, a.denominator});
    return rounded == 0 ? 0 : -rounded;
  }
  // A guess, put right by comparing the exact quotient with where roundings part; so no guess can be wrong.
  auto f = static_cast<float>(std::min(Approximate(a), static_cast<double>(std::numeric_limits<float>::max())));
  while (true) {
    const int beyond = Compare(a, UpperMidpoint(f));
    if (beyond < 0 || (beyond == 0 && !IsOdd(f))) break;
    f = std::nextafter(f, kInfinity);
    if (std::isinf(f)) return f;
  }
  while (f > 0) {
    const float previous = std::nextafter(f, 0.0f);
    const int before = Compare(a, UpperMidpoint(previous));
    if (before > 0 || (before == 0 && !IsOdd(f))) break;
    f = previous;
  }
  return f;
}

}  // namespace deltaray
