#include "server/service/token_file.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/store/sha256.h"

namespace deltaray {
namespace {

using testing::HasSubstr;
using testing::Not;

std::string Line(const std::string& role, const std::string& token) { return role + " " + Sha256::Hex(token) + "\n"; }

TEST(TokenFileTest, FindsRolesAndNobodyElse) {
  const auto table =
      TokenTable::Parse("# tokens\n\n" + Line("read", "alice") + "\t write\t" + Sha256::Hex("bob") + "  # Bob\r\n");
  ASSERT_TRUE(table.ok()) << table.status();
  EXPECT_EQ(table->size(), 2u);
  EXPECT_EQ(table->Find("alice"), Role::kRead);
  EXPECT_EQ(table->Find("bob"), Role::kWrite);
  for (const std::string& other : {std::string(), std::string("alic"), std::string("alice "), std::string("Alice"),
                                   std::string("alice\0", 6), Sha256::Hex("alice")}) {
    EXPECT_FALSE(table->Find(other).has_value()) << other;
  }
}

TEST(TokenFileTest, DigestsMayBeOfUpperCase) {
  std::string digest = Sha256::Hex("alice");
  for (char& c : digest) c = static_cast<char>(toupper(c));
  EXPECT_EQ(TokenTable::Parse("read " + digest)->Find("alice"), Role::kRead);
}

TEST(TokenFileTest, NamesTheLineOfAnErrorAndNothingThatMayBeAToken) {
  const std::string good = Line("read", "alice");
  for (const auto& [text, want] : {std::pair<std::string, std::string>("reader " + Sha256::Hex("x"), "first word"),
                                   {"secret-token", "first word"},
                                   {"read secret-token", "SHA-256"},
                                   {"read", "SHA-256"},
                                   {"read " + Sha256::Hex("x") + " secret-token", "no more"},
                                   {"read " + Sha256::Hex("x").substr(1) + "g", "SHA-256"},
                                   {Line("write", ""), "the SHA-256 of an empty token"},
                                   {Line("write", "alice"), "earlier line"}}) {
    const auto table = TokenTable::Parse(good + text);
    ASSERT_FALSE(table.ok()) << text;
    EXPECT_EQ(table.status().code(), absl::StatusCode::kInvalidArgument);
    EXPECT_THAT(std::string(table.status().message()), HasSubstr("line 2: "));
    EXPECT_THAT(std::string(table.status().message()), HasSubstr(want));
    EXPECT_THAT(std::string(table.status().message()), Not(HasSubstr("secret-token")));
  }
}

TEST(TokenFileTest, AFileWithoutTokensIsRefused) {
  for (const char* text : {"", "\n", "# read\n"}) EXPECT_FALSE(TokenTable::Parse(text).ok()) << text;
}

}  // namespace
}  // namespace deltaray
