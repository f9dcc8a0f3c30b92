#include "server/service/listen_address.h"

#include "gtest/gtest.h"

namespace deltaray {
namespace {

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
