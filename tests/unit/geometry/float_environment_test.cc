#include "server/geometry/float_environment.h"

#include <cfenv>
#include <thread>

#include "gtest/gtest.h"

#ifdef __SSE__
#include <xmmintrin.h>
#endif

namespace deltaray {
namespace {

// What is said in a thread of its own, so that the mode that it sets ends with it.
template <typename SetMode>
const char* FaultIn(SetMode set_mode) {
  const char* fault = nullptr;
  std::thread([&] {
    set_mode();
    fault = FloatEnvironmentFault();
  }).join();
  return fault;
}

TEST(FloatEnvironmentTest, IsRightUnlessSetOtherwise) { EXPECT_EQ(FloatEnvironmentFault(), nullptr); }

TEST(FloatEnvironmentTest, OtherRoundingsAreFaults) {
  for (const int mode : {FE_UPWARD, FE_DOWNWARD, FE_TOWARDZERO}) {
    EXPECT_STREQ(FaultIn([&] { std::fesetround(mode); }), "it does not round to nearest") << mode;
  }
}

#ifdef __SSE__
// As by a library that sets only the mode of the vector unit, which fegetround need not look at.
TEST(FloatEnvironmentTest, OtherRoundingsOfVectorsAreFaults) {
  for (const unsigned mode : {_MM_ROUND_UP, _MM_ROUND_DOWN, _MM_ROUND_TOWARD_ZERO}) {
    EXPECT_STREQ(FaultIn([&] { _MM_SET_ROUNDING_MODE(mode); }), "it does not round to nearest") << mode;
  }
}

TEST(FloatEnvironmentTest, LosingSubnormalNumbersIsAFault) {
  constexpr unsigned kDenormalsAreZero = 1 << 6;
  EXPECT_STREQ(FaultIn([] { _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON); }),
               "results that are subnormal become 0 (flush to zero)");
  EXPECT_STREQ(FaultIn([] { _mm_setcsr(_mm_getcsr() | kDenormalsAreZero); }),
               "numbers that are subnormal count as 0 (denormals are zero)");
}
#endif

}  // namespace
}  // namespace deltaray
