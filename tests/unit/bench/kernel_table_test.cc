#include "tests/bench/kernel_table.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace deltaray {
namespace {

using testing::HasSubstr;
using testing::MatchesRegex;

KernelRow Row(std::string scene, std::string rays, std::string engine, std::string mode, std::string level,
              double mrays_s, uint32_t threads = 1) {
  return {std::move(scene), std::move(rays), std::move(engine), std::move(mode), std::move(level), threads, mrays_s, 0};
}

TEST(KernelTableTest, WritesARowPerMeasurement) {
  KernelRow row = Row("bunny", "chords", "embree", "1M", "robust", 12.5, 2);
  row.spread = 0.0625;
  EXPECT_EQ(ToCsv(row), "bunny,chords,embree,1M,robust,2,12.500,0.062");
}

TEST(KernelTableTest, FindsTheFastestOfSomeModes) {
  const KernelTable table({Row("bunny", "chords", "embree", "single", "fast", 5),
                           Row("bunny", "chords", "embree", "1M", "fast", 7),
                           Row("bunny", "chords", "embree", "1M", "fast", 14, 2),
                           Row("bunny", "chords", "embree", "1M_coherent", "fast", 9)});
  EXPECT_EQ(table.Best("bunny", "chords", "embree", {"single", "1M"}, "fast", 1), 7);
  EXPECT_EQ(table.Best("bunny", "chords", "embree", {"single"}, "fast", 1), 5);
  EXPECT_EQ(table.Best("bunny", "chords", "embree", {"single", "1M"}, "fast", 2), 14);
  EXPECT_EQ(table.Best("bunny", "chords", "embree", {"single", "1M"}, "robust", 1), std::nullopt);
  EXPECT_EQ(table.Best("bunny", "camera", "embree", {"single"}, "fast", 1), std::nullopt);
}

TEST(KernelTableTest, SumsUpRatiosWithMeanAndMinimum) {
  const KernelTable table(
      {Row("a", "chords", "deltaray", "auto", "watertight", 8), Row("a", "chords", "embree", "single", "fast", 4),
       Row("a", "chords", "embree", "1M", "fast", 2), Row("a", "chords", "embree", "1M", "robust", 1),
       Row("b", "chords", "deltaray", "auto", "watertight", 4), Row("b", "chords", "embree", "single", "fast", 8),
       Row("a", "camera", "deltaray", "batch", "watertight", 99),
       Row("a", "camera", "deltaray", "auto", "watertight", 30), Row("a", "camera", "embree", "16", "fast", 20)});
  const std::vector<std::string> lines = table.Summary();
  ASSERT_EQ(lines.size(), 9u);
  EXPECT_THAT(lines[0], HasSubstr("auto / single or 1M, 1"));
  // Columns: fast/HIGH, watertight/HIGH, exact/HIGH, watertight/ROBUST.
  EXPECT_THAT(lines[1], MatchesRegex("a chords +- +2.00 +- +8.00"));
  EXPECT_THAT(lines[2], MatchesRegex("b chords +- +0.50 +- +-"));
  EXPECT_THAT(lines[3], MatchesRegex("geometric mean +- +1.00 +- +8.00"));
  EXPECT_THAT(lines[4], MatchesRegex("minimum +- +0.50 +- +8.00"));
  EXPECT_THAT(lines[6], MatchesRegex("a camera +- +1.50 +- +-"));
}

TEST(GeometricMeanTest, IsTheRootOfTheProduct) {
  EXPECT_DOUBLE_EQ(*GeometricMean({2, 8}), 4);
  EXPECT_EQ(GeometricMean({}), std::nullopt);
}

}  // namespace
}  // namespace deltaray
