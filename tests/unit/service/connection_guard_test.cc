#include "server/service/connection_guard.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <string>

#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"

namespace deltaray {
namespace {

// Both ends of a TCP connection of this process; a connection of the listener to `client` is that of the server.
class Loopback {
 public:
  explicit Loopback(int family) {
    listener_ = socket(family, SOCK_STREAM, 0);
    sockaddr_storage name{};
    name.ss_family = static_cast<sa_family_t>(family);
    if (family == AF_INET) {
      reinterpret_cast<sockaddr_in&>(name).sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    } else {
      reinterpret_cast<sockaddr_in6&>(name).sin6_addr = in6addr_loopback;
    }
    socklen_t length = family == AF_INET ? sizeof(sockaddr_in) : sizeof(sockaddr_in6);
    auto* const any_name = reinterpret_cast<sockaddr*>(&name);
    if (bind(listener_, any_name, length) != 0 || listen(listener_, 1) != 0) return;  // no IPv6 here
    getsockname(listener_, any_name, &length);
    client_ = socket(family, SOCK_STREAM, 0);
    EXPECT_EQ(connect(client_, any_name, length), 0);
    server_ = accept(listener_, any_name, &length);
    // sin6_port lies where sin_port does.
    const int port = ntohs(reinterpret_cast<const sockaddr_in&>(name).sin_port);
    peer_ = absl::StrCat(family == AF_INET ? "ipv4:127.0.0.1:" : "ipv6:%5B::1%5D:", port);
  }
  ~Loopback() {
    for (const int file : {listener_, client_, server_}) {
      if (file >= 0) close(file);
    }
  }
  Loopback(const Loopback&) = delete;
  Loopback& operator=(const Loopback&) = delete;

  bool is_there() const { return server_ >= 0; }
  // As gRPC writes it, for the server.
  const std::string& peer() const { return peer_; }
  // Whether the client sees that the connection has been closed.
  bool IsClosed() const {
    char byte;
    return recv(client_, &byte, 1, MSG_DONTWAIT) == 0;
  }

 private:
  int listener_ = -1, client_ = -1, server_ = -1;
  std::string peer_;
};

TEST(ShutDownConnectionTest, FindsTheSocketByItsPeer) {
  for (const int family : {AF_INET, AF_INET6}) {
    const Loopback connection(family);
    if (!connection.is_there()) continue;
    // A port that no client is given.
    EXPECT_FALSE(ShutDownConnection(connection.peer().substr(0, connection.peer().rfind(':')) + ":1"));
    EXPECT_FALSE(connection.IsClosed());
    EXPECT_TRUE(ShutDownConnection(connection.peer()));
    EXPECT_TRUE(connection.IsClosed());
  }
  EXPECT_FALSE(ShutDownConnection("unix:"));
  EXPECT_FALSE(ShutDownConnection("ipv4:127.0.0.1"));
}

class ConnectionGuardTest : public testing::Test {
 protected:
  absl::Status Begin(const std::string& peer) {
    CallRecord record;
    record.peer = peer;
    RpcInfo rpc;
    rpc.record = &record;
    return guard_.OnBegin(rpc);
  }
  void End(const std::string& peer) {
    CallRecord record;
    record.peer = peer;
    RpcInfo rpc;
    rpc.record = &record;
    guard_.OnEnd(rpc, absl::OkStatus());
  }

  static constexpr int kLimit = 4 * 5 + 64;
  ConnectionGuard guard_{5};
};

TEST_F(ConnectionGuardTest, ClosesConnectionsWhoseCallsDoNotEnd) {
  const Loopback connection(AF_INET), other(AF_INET);
  for (int i = 0; i < kLimit; ++i) {
    ASSERT_TRUE(Begin(connection.peer()).ok()) << i;
    ASSERT_TRUE(Begin(other.peer()).ok()) << i;
    End(other.peer());
  }
  EXPECT_FALSE(connection.IsClosed());
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(Begin(connection.peer()),
              absl::ResourceExhaustedError("more than 84 calls of the connection have not ended"));
  }
  EXPECT_TRUE(connection.IsClosed());
  EXPECT_FALSE(other.IsClosed());
  // Refused calls end, too.
  for (int i = 0; i < kLimit + 3; ++i) End(connection.peer());
  EXPECT_TRUE(Begin(connection.peer()).ok());
}

TEST_F(ConnectionGuardTest, LeavesUnixSocketsAlone) {
  for (int i = 0; i < 2 * kLimit; ++i) ASSERT_TRUE(Begin("unix:").ok()) << i;
}

}  // namespace
}  // namespace deltaray
