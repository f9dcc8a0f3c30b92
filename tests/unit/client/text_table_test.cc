#include "client/text_table.h"

#include <gtest/gtest.h>

namespace deltaray {
namespace {

TEST(TextTableTest, AlignsColumnsByCodePoints) {
  TextTable table({Align::kLeft, Align::kRight, Align::kLeft});
  table.Add({"δ", "1", "a"});
  table.Add({"abc", "1,000", "b"});
  table.Add({"short"});
  EXPECT_EQ(table.Render(),
            "δ          1  a\n"
            "abc    1,000  b\n"
            "short\n");
}

TEST(TextTableTest, CellsCannotDriveTheTerminal) {
  TextTable table({Align::kLeft});
  table.Add({"a\033[31m\r\nb\x7F\xC2\x9B"});
  EXPECT_EQ(table.Render(), "a?[31m??b??\n");
  EXPECT_EQ(Printable("größe"), "größe");
  EXPECT_EQ(Printable("\xC2\xA0"), "\xC2\xA0");
}

TEST(TextTableTest, NumbersForPeople) {
  EXPECT_EQ(GroupDigits(0), "0");
  EXPECT_EQ(GroupDigits(999), "999");
  EXPECT_EQ(GroupDigits(1000), "1,000");
  EXPECT_EQ(GroupDigits(18446744073709551615u), "18,446,744,073,709,551,615");
  EXPECT_EQ(BytesText(1023), "1023 B");
  EXPECT_EQ(BytesText(1536), "1.5 KiB");
  EXPECT_EQ(BytesText(uint64_t{5} << 40), "5.0 TiB");
  EXPECT_EQ(SecondsText(1.23456), "1.235 s");
}

}  // namespace
}  // namespace deltaray
