#include "client/retry.h"

#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <string>
#include <thread>

#include "gtest/gtest.h"
#include "tests/unit/client/fake_server.h"
#include "tests/unit/client/test_session.h"

namespace deltaray {
namespace {

// Accepts connections in place of a server that has gone, and closes each at once.
class ClosingListener {
 public:
  ~ClosingListener() {
    shutdown(fd_, SHUT_RDWR);  // wakes accept()
    if (thread_.joinable()) thread_.join();
    close(fd_);
  }

  // `address`: 127.0.0.1 and a port that is free.
  void Listen(const std::string& address) {
    sockaddr_in where{.sin_family = AF_INET,
                      .sin_port = htons(static_cast<uint16_t>(std::stoi(address.substr(address.find(':') + 1)))),
                      .sin_addr = {htonl(INADDR_LOOPBACK)},
                      .sin_zero = {}};
    const int on = 1;
    setsockopt(fd_, SOL_SOCKET, SO_REUSEADDR, &on, sizeof(on));
    ASSERT_EQ(bind(fd_, reinterpret_cast<const sockaddr*>(&where), sizeof(where)), 0) << std::strerror(errno);
    ASSERT_EQ(listen(fd_, 16), 0) << std::strerror(errno);
    thread_ = std::thread([this] {
      for (int connection; (connection = accept(fd_, nullptr, nullptr)) >= 0; ++accepted_) close(connection);
    });
  }

  int accepted() const { return accepted_; }

 private:
  const int fd_ = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  std::atomic<int> accepted_ = 0;
  std::thread thread_;
};

const grpc::Status kLost(grpc::StatusCode::UNAVAILABLE, "lost");

TEST(IsLossTest, OnlyALostServerIsALoss) {
  EXPECT_TRUE(IsLoss(kLost));
  EXPECT_TRUE(IsLoss(grpc::Status::CANCELLED));
  EXPECT_TRUE(IsLoss({grpc::StatusCode::INTERNAL, "Received RST_STREAM with error code 2"}));
  EXPECT_FALSE(IsLoss({grpc::StatusCode::INTERNAL, "a defect"}));
  EXPECT_FALSE(IsLoss({grpc::StatusCode::RESOURCE_EXHAUSTED, "too much"}));
  EXPECT_FALSE(IsLoss({grpc::StatusCode::DEADLINE_EXCEEDED, "late"}));
  EXPECT_FALSE(IsLoss(grpc::Status::OK));
}

class RetryTest : public testing::Test {
 protected:
  RetryTest() : session_(server_.address()), connection_(Connection::Open(session_.session())) {
    EXPECT_TRUE(connection_.ok()) << connection_.status();
  }

  FakeServer server_;
  TestSession session_;
  absl::StatusOr<Connection> connection_;
};

TEST_F(RetryTest, EndsAfterItsTimeWhichASuccessBeginsAnew) {
  session_.session().retry_seconds = 1;
  Retry retry(*connection_);
  const auto begin = std::chrono::steady_clock::now();
  int tries = 0;
  while (retry.Again(kLost)) ++tries;
  EXPECT_GE(tries, 2);
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(5));
  EXPECT_FALSE(retry.Again(kLost));
  retry.Succeeded();
  EXPECT_TRUE(retry.Again(kLost));
}

TEST_F(RetryTest, NeverWithoutTimeOrAfterAStop) {
  EXPECT_FALSE(Retry(*connection_).Again(kLost));
  session_.session().retry_seconds = 3600;
  session_.stop.Fire();
  EXPECT_FALSE(Retry(*connection_).Again(kLost));
}

// A server that closes each connection: while somebody waits, the next is made soon, and not when gRPC looks again by
// itself, every 5 s.
TEST_F(RetryTest, WaitingConnectsAnew) {
  ClosingListener closing;
  server_.Stop();
  closing.Listen(server_.address());
  const auto begin = std::chrono::steady_clock::now();
  while (closing.accepted() < 10 && std::chrono::steady_clock::now() - begin < std::chrono::seconds(30)) {
    connection_->Wait(std::chrono::milliseconds(100));
  }
  EXPECT_GE(closing.accepted(), 10);
}

}  // namespace
}  // namespace deltaray
