// Exact numbers: sums and products of floating-point numbers, and quotients of these.

#ifndef TESTS_ORACLE_DYADIC_H_
#define TESTS_ORACLE_DYADIC_H_

#include <boost/multiprecision/cpp_int.hpp>
#include <utility>

namespace deltaray {

// An integer of any size times a power of two. Every finite floating-point number is one, and sums, differences and
// products of such are: nothing here rounds.
class Dyadic {
 public:
  Dyadic() = default;
  // REQUIRES: `x` is finite.
  explicit Dyadic(double x);

  // -1, 0 or 1.
  int Sign() const { return mantissa_.sign(); }
  // mantissa · 2^*exponent, within 2^-52 of this number, of a magnitude of less than 2^64.
  double Approximate(int* exponent) const;

  friend Dyadic operator+(const Dyadic& a, const Dyadic& b);
  friend Dyadic operator-(const Dyadic& a, const Dyadic& b);
  friend Dyadic operator*(const Dyadic& a, const Dyadic& b);
  Dyadic operator-() const;

 private:
  // Of any size, but without memory from the heap up to the size that ordinary scenes need.
  using Integer = boost::multiprecision::number<
      boost::multiprecision::cpp_int_backend<512, 0, boost::multiprecision::signed_magnitude,
                                             boost::multiprecision::unchecked>,
      boost::multiprecision::et_off>;

  Dyadic(Integer mantissa, int exponent) : mantissa_(std::move(mantissa)), exponent_(exponent) {}

  Integer mantissa_;
  int exponent_ = 0;
};

// numerator / denominator. REQUIRES: denominator > 0.
struct Quotient {
  Dyadic numerator, denominator;
};

// The sign of a - b.
int Compare(const Quotient& a, const Quotient& b);
// The same; `b` is not NaN.
int Compare(const Quotient& a, double b);

// Within 2^-50 of the quotient, of its magnitude.
double Approximate(const Quotient& a);

// Rounded to nearest even; never -0.
float RoundToFloat(const Quotient& a);

}  // namespace deltaray

#endif  // TESTS_ORACLE_DYADIC_H_
