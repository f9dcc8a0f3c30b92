#include "server/mesh/line_cursor.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <ctime>
#include <string>
#include <vector>

namespace deltaray {
namespace {

std::vector<std::string> Lines(absl::string_view text) {
  LineCursor cursor(text, 1000);
  std::vector<std::string> lines;
  absl::string_view line;
  while (*cursor.Next(&line)) {
    lines.emplace_back(line);
    EXPECT_EQ(cursor.where().number, lines.size());
  }
  EXPECT_EQ(cursor.position(), text.size());
  return lines;
}

TEST(LineCursorTest, LinesEndInAnyWay) {
  using testing::ElementsAre;
  EXPECT_THAT(Lines(""), ElementsAre());
  EXPECT_THAT(Lines("\n"), ElementsAre(""));
  EXPECT_THAT(Lines("a"), ElementsAre("a"));
  EXPECT_THAT(Lines("a\nb\r\nc\rd"), ElementsAre("a", "b", "c", "d"));
  EXPECT_THAT(Lines("\r\r\n\n\r"), ElementsAre("", "", "", ""));
  EXPECT_THAT(Lines("a\n\n\nb\n"), ElementsAre("a", "", "", "b"));
}

TEST(LineCursorTest, PassesOverAByteOrderMark) {
  EXPECT_THAT(Lines("\xEF\xBB\xBF"
                    "a\nb"),
              testing::ElementsAre("a", "b"));
  EXPECT_THAT(Lines("a\n\xEF\xBB\xBF"), testing::ElementsAre("a", "\xEF\xBB\xBF"));
}

TEST(LineCursorTest, PositionIsWhereTheNextLineBegins) {
  LineCursor cursor("ab\r\ncd\n", 1000);
  absl::string_view line;
  ASSERT_TRUE(*cursor.Next(&line));
  EXPECT_EQ(cursor.position(), 4u);
}

TEST(LineCursorTest, RefusesLongLines) {
  LineCursor cursor("abcd\nabcde\n", 4);
  absl::string_view line;
  EXPECT_TRUE(cursor.Next(&line).ok());
  const absl::Status status = cursor.Next(&line).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(status.message(), "line 2: the line has 5 bytes, more than 4 (--max-line-bytes)");
}

// Looking for a line feed from each of the lines on takes time in proportion to the square of the file's size.
TEST(LineCursorTest, LinesThatEndInCarriageReturnsTakeLinearTime) {
  const std::string text(4'000'000, '\r');
  LineCursor cursor(text, 1000);
  absl::string_view line;
  const std::clock_t start = std::clock();
  while (*cursor.Next(&line)) {
  }
  EXPECT_EQ(cursor.where().number, text.size());
  EXPECT_LT(static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC, 10);
}

}  // namespace
}  // namespace deltaray
