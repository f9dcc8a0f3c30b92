#include "tests/oracle/dyadic.h"

#include <cmath>
#include <limits>

#include "gtest/gtest.h"
#include "tests/oracle/rational_hit.h"
#include "tests/scenes/random.h"

namespace deltaray {
namespace {

constexpr float kDenormal = std::numeric_limits<float>::denorm_min(), kMax = std::numeric_limits<float>::max();

Quotient MakeQuotient(double a, double b) { return {Dyadic(a), Dyadic(b)}; }

double OfAnySize(Random& random) {
  const double x = random.LogUniform(0x1p-149, 0x1p127);
  return random.Below(2) == 0 ? x : -x;
}

TEST(DyadicTest, SumsAndProductsAreExact) {
  Random random(1);
  for (int i = 0; i < 2000; ++i) {
    const double a = OfAnySize(random), b = OfAnySize(random), c = OfAnySize(random);
    const Rational expected = (ToRational(a) + ToRational(b)) * ToRational(c) - ToRational(a);
    const Dyadic found = (Dyadic(a) + Dyadic(b)) * Dyadic(c) - Dyadic(a);
    EXPECT_EQ(found.Sign(), expected.sign());
    EXPECT_TRUE(IsNearestEven(RoundToFloat({found, Dyadic(0x1p100)}), expected / ToRational(0x1p100)));
  }
  EXPECT_EQ((Dyadic(3) - Dyadic(3)).Sign(), 0);
  EXPECT_EQ((Dyadic(0) * Dyadic(-5)).Sign(), 0);
}

TEST(DyadicTest, QuotientsRoundToNearestEven) {
  Random random(2);
  for (int i = 0; i < 5000; ++i) {
    const double a = OfAnySize(random), b = std::abs(OfAnySize(random));
    EXPECT_TRUE(IsNearestEven(RoundToFloat(MakeQuotient(a, b)), ToRational(a) / ToRational(b))) << a << " / " << b;
    EXPECT_NEAR(Approximate(MakeQuotient(a, b)) / (a / b), 1, 0x1p-50);
  }
}

TEST(DyadicTest, RoundsTiesDenormalsAndTheGreatest) {
  EXPECT_EQ(RoundToFloat(MakeQuotient(0x1p24 + 1, 1)), 0x1p24f);
  EXPECT_EQ(RoundToFloat(MakeQuotient(0x1p24 + 3, 1)), 0x1p24f + 4);
  EXPECT_EQ(RoundToFloat(MakeQuotient(3 * 0x1p-149, 2)), 2 * kDenormal);
  EXPECT_EQ(RoundToFloat(MakeQuotient(0x1p-149, 2)), 0);
  EXPECT_FALSE(std::signbit(RoundToFloat(MakeQuotient(-0x1p-149, 2))));
  EXPECT_EQ(RoundToFloat(MakeQuotient(-0x1.8p-149, 1)), -2 * kDenormal);
  EXPECT_EQ(RoundToFloat(MakeQuotient(0x1p128 - 0x1p103, 1)), std::numeric_limits<float>::infinity());
  EXPECT_EQ(RoundToFloat(MakeQuotient(0x1p128 - 0x1p103 - 0x1p80, 1)), kMax);
}

TEST(DyadicTest, ComparesQuotients) {
  EXPECT_EQ(Compare(MakeQuotient(1, 3), MakeQuotient(2, 6)), 0);
  EXPECT_EQ(Compare(MakeQuotient(-1, 3), MakeQuotient(1, 1e30)), -1);
  EXPECT_EQ(Compare(MakeQuotient(1, 3), 0.3333333333333333), 1);
  EXPECT_EQ(Compare(MakeQuotient(1, 3), std::numeric_limits<double>::infinity()), -1);
  EXPECT_EQ(Compare(MakeQuotient(1, 3), -std::numeric_limits<double>::infinity()), 1);
}

}  // namespace
}  // namespace deltaray
