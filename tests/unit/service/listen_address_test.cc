#include "server/service/listen_address.h"

#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace deltaray {
namespace {

TEST(ListenAddressTest, TakesWhatCanBeListenedAt) {
  for (const char* address : {"127.0.0.1:0", "0.0.0.0:65535", "[::]:7878", "example.org:80", "unix:/run/deltaray"}) {
    EXPECT_TRUE(ValidateListenAddress(address).ok()) << address;
  }
  for (const char* address : {"", ":7878", "127.0.0.1", "::1:80", "dns:///localhost:1", "unix:", "localhost:",
                              "localhost:http", "localhost:-1", "localhost:+1", "localhost: 1"}) {
    EXPECT_EQ(ValidateListenAddress(address).code(), absl::StatusCode::kInvalidArgument) << address;
  }
  for (const char* address : {"127.0.0.1:65536", "127.0.0.1:99999", "[::1]:99999999999999999999"}) {
    EXPECT_THAT(std::string(ValidateListenAddress(address).message()), testing::HasSubstr("range 0 to 65535"));
  }
}

TEST(ListenAddressTest, KnowsLoopbackFromTheRest) {
  for (const char* address : {"127.0.0.1:7878", "127.1.2.3:0", "localhost:1", "[::1]:7878", "unix:/run/deltaray"}) {
    EXPECT_TRUE(IsLoopback(address)) << address;
  }
  for (const char* address : {"0.0.0.0:7878", "[::]:7878", "128.0.0.1:1", "example.org:80", "127.0.0.1", "", ":7878",
                              "127.0.0.1.example.org:80", "localhost.example.org:1", "::1:80", "dns:///localhost:1"}) {
    EXPECT_FALSE(IsLoopback(address)) << address;
  }
}

}  // namespace
}  // namespace deltaray
