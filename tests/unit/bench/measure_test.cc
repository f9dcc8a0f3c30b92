#include "tests/bench/measure.h"

#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace deltaray {
namespace {

using testing::ElementsAre;

TEST(SamplesTest, TellsMedianQuartersAndSpread) {
  Samples samples;
  for (const double value : {5, 1, 4, 2, 3}) samples.Add(value);
  EXPECT_DOUBLE_EQ(samples.median(), 3);
  EXPECT_DOUBLE_EQ(samples.low(), 2);
  EXPECT_DOUBLE_EQ(samples.high(), 4);
  EXPECT_DOUBLE_EQ(samples.spread(), 2.0 / 3);
  samples.Add(10);
  EXPECT_DOUBLE_EQ(samples.median(), 3.5);
}

TEST(PeakMemoryTest, SeesWhatWasFreedAgain) {
#ifdef DELTARAY_SANITIZED
  GTEST_SKIP() << "what a sanitizer notes beside each byte is resident too";
#endif
  const PeakMemory memory;
  constexpr size_t kBytes = 64 << 20;
  { const std::vector<char> block(kBytes, 1); }
  EXPECT_GE(memory.bytes(), kBytes * 9 / 10);
  EXPECT_LT(memory.bytes(), 2 * kBytes);
  EXPECT_LT(PeakMemory().bytes(), kBytes / 2);
}

TEST(InterleaveTest, StartsEachRoundWithAnother) {
  std::vector<size_t> order;
  const absl::Status status = Interleave(3, 2, [&order](size_t i) {
    order.push_back(i);
    return absl::OkStatus();
  });
  EXPECT_TRUE(status.ok());
  EXPECT_THAT(order, ElementsAre(0, 1, 2, 1, 2, 0));
}

TEST(InterleaveTest, StopsAtTheFirstError) {
  int calls = 0;
  const absl::Status status = Interleave(3, 2, [&calls](size_t i) {
    ++calls;
    return i == 1 ? absl::InternalError("1") : absl::OkStatus();
  });
  EXPECT_EQ(status, absl::InternalError("1"));
  EXPECT_EQ(calls, 2);
}

TEST(ParseSimdTargetTest, KnowsTheTargetsByName) {
  EXPECT_EQ(*ParseSimdTarget("best"), std::nullopt);
  EXPECT_EQ(*ParseSimdTarget("avx2"), SimdTarget::kAvx2);
  EXPECT_EQ(ParseSimdTarget("mmx").status(),
            absl::InvalidArgumentError("no SIMD target 'mmx'; there are best, sse4, avx2, avx512"));
}

}  // namespace
}  // namespace deltaray
