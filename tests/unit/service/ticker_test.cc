#include "server/service/ticker.h"

#include <atomic>
#include <thread>

#include "grpcpp/alarm.h"
#include "gtest/gtest.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using std::chrono::milliseconds;

TEST(TickerTest, TicksUntilItIsDestroyed) {
  // As in a server, gRPC is there before and after.
  const grpc::Alarm grpc_is_there;
  std::atomic<int> ticks{0};
  {
    const Ticker ticker(milliseconds(10), [&] { ++ticks; });
    EXPECT_TRUE(Eventually([&] { return ticks >= 5; }));
  }
  const int at_end = ticks;
  std::this_thread::sleep_for(milliseconds(100));
  EXPECT_EQ(ticks, at_end);
}

}  // namespace
}  // namespace deltaray
