#include "server/service/security_options.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace deltaray {
namespace {

using testing::HasSubstr;

SecurityOptions Tls() { return {.tls_cert = "c", .tls_key = "k", .tls_client_ca = "", .token_file = ""}; }

TEST(SecurityOptionsTest, PlaintextBeyondThisMachineMustBeMeant) {
  const SecurityOptions plain;
  EXPECT_TRUE(ValidateSecurity(plain, "127.0.0.1:1", false).ok());
  EXPECT_TRUE(ValidateSecurity(plain, "0.0.0.0:1", true).ok());
  EXPECT_TRUE(ValidateSecurity(Tls(), "0.0.0.0:1", false).ok());
  for (const char* address : {"0.0.0.0:1", "[::]:1", "example.com:1"}) {
    const absl::Status status = ValidateSecurity(plain, address, false);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    EXPECT_THAT(std::string(status.message()), HasSubstr("--insecure-listen"));
    EXPECT_THAT(std::string(status.message()), HasSubstr(address));
  }
  const SecurityOptions tokens = {.tls_cert = "", .tls_key = "", .tls_client_ca = "", .token_file = "t"};
  EXPECT_TRUE(ValidateSecurity(tokens, "127.0.0.1:1", false).ok());
  EXPECT_THAT(std::string(ValidateSecurity(tokens, "0.0.0.0:1", false).message()), HasSubstr("read tokens"));
}

TEST(SecurityOptionsTest, FlagsThatNeedEachOther) {
  SecurityOptions options = Tls();
  options.tls_key.clear();
  EXPECT_EQ(ValidateSecurity(options, "127.0.0.1:1", true).message(), "--tls-cert: --tls-key is missing");
  options = Tls();
  options.tls_cert.clear();
  EXPECT_EQ(ValidateSecurity(options, "127.0.0.1:1", true).message(), "--tls-key: --tls-cert is missing");
  options.tls_key.clear();
  options.tls_client_ca = "a";
  EXPECT_THAT(std::string(ValidateSecurity(options, "127.0.0.1:1", true).message()), HasSubstr("--tls-client-ca"));
}

}  // namespace
}  // namespace deltaray
