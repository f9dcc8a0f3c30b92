#include "server/service/watchdog.h"

#include <fcntl.h>
#include <sys/resource.h>
#include <unistd.h>

#include <atomic>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/unit/service/captured_log.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using testing::HasSubstr;

TEST(WatchdogTest, TellsOfFailuresAndOfTheirEnd) {
  CapturedLog log(LogFormat::kText);
  std::atomic<bool> ill{false};
  std::atomic<int> looks{0}, failures{0};
  {
    Watchdog watchdog(
        std::chrono::milliseconds(5),
        [&] {
          ++looks;
          return ill ? "deaf" : "";
        },
        [&] { ++failures; });
    EXPECT_TRUE(Eventually([&] { return looks >= 3; }));
    EXPECT_EQ(failures, 0);
    ill = true;
    EXPECT_TRUE(Eventually([&] { return failures >= 2; }));
    ill = false;
    // The second look from here on began after that, and the third one after its line was written.
    const int before = looks;
    EXPECT_TRUE(Eventually([&] { return looks >= before + 3; }));
  }
  EXPECT_THAT(log.text(), HasSubstr("[error] watchdog: deaf"));
  EXPECT_THAT(log.text(), HasSubstr("[info] watchdog: all is well again"));
}

class WatchedServer : public RunningServer {
 protected:
  WatchedServer() {
    options_.watchdog_interval = std::chrono::milliseconds(50);
    options_.metrics_listen = "127.0.0.1:0";
  }

  // A call on a connection of its own.
  bool Works(const std::string& address) {
    grpc::ChannelArguments arguments;
    arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    const auto channel = grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), arguments);
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(2));
    v1::ListMeshesResponse list;
    return v1::MeshService::NewStub(channel)->ListMeshes(&context, {}, &list).ok();
  }
};

TEST_F(WatchedServer, ListensAnewWhereItsSocketFileHasGone) {
  const std::string path = directory_ + "/socket";
  options_.listen = "unix:" + path;
  Start();
  ASSERT_TRUE(Works(options_.listen));
  std::filesystem::remove(path);
  EXPECT_TRUE(Eventually([&] { return Works(options_.listen); }));
}

TEST_F(WatchedServer, NoticesThatFileDescriptorsHaveRunOutAndHearsAgainAfterwards) {
#ifdef DELTARAY_SANITIZED
  GTEST_SKIP() << "UndefinedBehaviorSanitizer takes two file descriptors to look at an object";
#endif
  CapturedLog log(LogFormat::kText);
  Start();
  const std::string address = absl::StrCat("127.0.0.1:", server_->port());
  ASSERT_TRUE(Works(address));
  rlimit before;
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  rlimit few = before;
  few.rlim_cur = 200;
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &few), 0);
  std::vector<int> files;
  // Again and again, since connections of before are closed meanwhile; longer than the watchdog's patience.
  for (int i = 0; i < 300; ++i) {
    for (int file; (file = open("/dev/null", O_RDONLY | O_CLOEXEC)) >= 0;) files.push_back(file);
    EXPECT_EQ(errno, EMFILE);
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  for (const int file : files) close(file);
  setrlimit(RLIMIT_NOFILE, &before);
  EXPECT_TRUE(Eventually([&] { return Works(address); }));
  std::this_thread::sleep_for(std::chrono::seconds(1));  // for the watchdog to look again
  server_.reset();
  EXPECT_THAT(log.text(), HasSubstr("watchdog: connections to " + address + " are not accepted"));
  EXPECT_THAT(log.text(), HasSubstr("all is well again"));
}

TEST_F(WatchedServer, IsSilentWhereAllIsWell) {
  CapturedLog log(LogFormat::kText);
  Start();
  std::this_thread::sleep_for(std::chrono::milliseconds(500));
  server_.reset();
  EXPECT_THAT(log.text(), testing::Not(HasSubstr("watchdog")));
  EXPECT_THAT(log.text(), testing::Not(HasSubstr("error")));
}

}  // namespace
}  // namespace deltaray
