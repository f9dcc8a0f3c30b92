#include "server/mesh/number.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>
#include <random>

#include "server/mesh/utf8.h"

namespace deltaray {
namespace {

TEST(NumberTest, ReadsDecimals) {
  const std::pair<const char*, double> cases[] = {{"1", 1},
                                                  {"+1", 1},
                                                  {"-1", -1},
                                                  {"1.", 1},
                                                  {".5", 0.5},
                                                  {"-.5e1", -5},
                                                  {"2.e-1", 0.2},
                                                  {"1E+2", 100},
                                                  {"007", 7},
                                                  {"0.1", 0.1},
                                                  {"1e-400", 0},
                                                  {"5e-324", 5e-324},
                                                  {"1e400", INFINITY},
                                                  {"-1e400", -INFINITY},
                                                  {"9007199254740993", 9007199254740992.0}};
  for (const auto& [text, expected] : cases) {
    double value = 7;
    EXPECT_TRUE(ParseDouble(text, &value)) << text;
    EXPECT_EQ(value, expected) << text;
  }
}

TEST(NumberTest, RefusesAllElse) {
  for (const char* text :
       {"",   "+",    "-",   ".",   "+-1", "-+1",  "--1",      "1e",  "1e+",   "e1",  "1 ",      " 1",
        "1x", "0x10", "nan", "NaN", "inf", "-inf", "infinity", "1,5", "1.2.3", "1d5", "\xC2\xBD"}) {
    double value;
    EXPECT_FALSE(ParseDouble(text, &value)) << text;
  }
  double value;
  EXPECT_FALSE(ParseDouble(absl::string_view("1\0", 2), &value));
}

TEST(NumberTest, ReadsBackWhatPrintfWrites) {
  std::mt19937_64 random(1);
  for (int round = 0; round < 100000; ++round) {
    const uint64_t bits = random();
    double expected;
    std::memcpy(&expected, &bits, 8);
    if (!std::isfinite(expected)) continue;
    char text[40];
    std::snprintf(text, sizeof(text), "%.17g", expected);
    double value;
    ASSERT_TRUE(ParseDouble(text, &value)) << text;
    ASSERT_EQ(value, expected) << text;
  }
}

TEST(NumberTest, IntegersHaveToFit) {
  int value;
  EXPECT_TRUE(ParseInteger("-2147483648", &value));
  EXPECT_EQ(value, std::numeric_limits<int>::min());
  for (const char* text : {"", "-", "+1", "1.0", "2147483648", " 1", "1 ", "0x1"}) {
    EXPECT_FALSE(ParseInteger(text, &value)) << text;
  }
}

TEST(NumberTest, TokensStandBetweenSpacesAndTabs) {
  absl::string_view text = "  a\t\tbc d ";
  EXPECT_EQ(NextToken(&text), "a");
  EXPECT_EQ(NextToken(&text), "bc");
  EXPECT_EQ(NextToken(&text), "d");
  EXPECT_EQ(NextToken(&text), "");
}

TEST(Utf8Test, ReplacesWhatIsNotValid) {
  const std::string bad = "\xEF\xBF\xBD";
  EXPECT_EQ(ToValidUtf8("Gr\xC3\xBC\xC3\x9F \xE2\x82\xAC \xF0\x9F\x98\x80"),
            "Gr\xC3\xBC\xC3\x9F \xE2\x82\xAC \xF0\x9F\x98\x80");
  EXPECT_EQ(ToValidUtf8("a\xFCz"), "a" + bad + "z");
  EXPECT_EQ(ToValidUtf8("\xC3"), bad);
  EXPECT_EQ(ToValidUtf8("\xC0\x80"), bad + bad);                      // overlong
  EXPECT_EQ(ToValidUtf8("\xE0\x80\x80"), bad + bad + bad);            // overlong
  EXPECT_EQ(ToValidUtf8("\xED\xA0\x80"), bad + bad + bad);            // a surrogate
  EXPECT_EQ(ToValidUtf8("\xF4\x90\x80\x80"), bad + bad + bad + bad);  // past U+10FFFF
  EXPECT_EQ(ToValidUtf8("a\x1B[2Jb\x7F"), "a" + bad + "[2Jb" + bad);
}

}  // namespace
}  // namespace deltaray
