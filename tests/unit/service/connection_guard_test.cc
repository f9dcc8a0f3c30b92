#include "server/service/connection_guard.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <cerrno>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/unit/service/captured_log.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using testing::HasSubstr;

// A client that speaks HTTP/2 by the byte.
class RawClient {
 public:
  explicit RawClient(int port) : socket_(socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in ipv4{};
    ipv4.sin_family = AF_INET;
    ipv4.sin_port = htons(static_cast<in_port_t>(port));
    ipv4.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(connect(socket_, reinterpret_cast<const sockaddr*>(&ipv4), sizeof(ipv4)), 0);
    const timeval patience{10, 0};
    setsockopt(socket_, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof(patience));
    Send("PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + Frame(kSettings, 0, 0, "") + Frame(kSettings, kAck, 0, ""));
  }
  ~RawClient() { close(socket_); }
  RawClient(const RawClient&) = delete;
  RawClient& operator=(const RawClient&) = delete;

  // False: the connection is closed.
  bool Send(const std::string& bytes) {
    return send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(bytes.size());
  }
  // Begins a call and resets it.
  bool CallAndReset(const std::string& method) {
    const uint32_t stream = std::exchange(next_stream_, next_stream_ + 2);
    return Send(Frame(kHeaders, kEndHeaders, stream,
                      Field(":method", "POST") + Field(":scheme", "http") + Field(":path", method) +
                          Field(":authority", "server") + Field("content-type", "application/grpc") +
                          Field("te", "trailers")) +
                Frame(kReset, 0, stream, std::string("\0\0\0\x08", 4)));
  }
  // Waits until the server closes the connection; false where it does not.
  bool IsClosed() {
    char bytes[4096];
    ssize_t got;
    while ((got = recv(socket_, bytes, sizeof(bytes), 0)) > 0) {
    }
    return got == 0 || errno == ECONNRESET;
  }
  // Reads and drops what the server has sent so far.
  void Drop() {
    char bytes[4096];
    while (recv(socket_, bytes, sizeof(bytes), MSG_DONTWAIT) > 0) {
    }
  }

 private:
  static constexpr char kHeaders = 1, kReset = 3, kSettings = 4, kAck = 1, kEndHeaders = 4;

  static std::string Frame(char type, char flags, uint32_t stream, const std::string& payload) {
    std::string frame;
    for (int shift = 16; shift >= 0; shift -= 8) frame += static_cast<char>(payload.size() >> shift);
    frame += type;
    frame += flags;
    for (int shift = 24; shift >= 0; shift -= 8) frame += static_cast<char>(stream >> shift);
    return frame + payload;
  }
  // As HPACK has it: literal, not indexed, not compressed.
  static std::string Field(const std::string& name, const std::string& value) {
    return std::string(1, '\0') + static_cast<char>(name.size()) + name + static_cast<char>(value.size()) + value;
  }

  const int socket_;
  uint32_t next_stream_ = 1;
};

class ConnectionGuardTest : public RunningServer {};

TEST_F(ConnectionGuardTest, ClosesConnectionsThatResetTheirCallsAtOnce) {
  options_.max_connection_calls = 4;
  Start();
  CapturedLog log(LogFormat::kText);
  RawClient client(server_->port());
  bool open = true;
  for (int i = 0; i < 100'000 && open; ++i) {
    open = client.CallAndReset("/deltaray.v1.RayService/StreamRays");
    client.Drop();
  }
  EXPECT_TRUE(client.IsClosed());
  // Others are served.
  grpc::ClientContext context;
  v1::ListMeshesResponse list;
  EXPECT_TRUE(meshes_->ListMeshes(&context, {}, &list).ok());
  server_.reset();
  EXPECT_THAT(log.text(), HasSubstr("more than 80 of its calls have not ended"));
}

TEST(ShutDownConnectionTest, FindsTheSocketByItsPeer) {
  for (const int family : {AF_INET, AF_INET6}) {
    const int listener = socket(family, SOCK_STREAM, 0);
    sockaddr_storage name{};
    name.ss_family = static_cast<sa_family_t>(family);
    if (family == AF_INET) {
      reinterpret_cast<sockaddr_in&>(name).sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    } else {
      reinterpret_cast<sockaddr_in6&>(name).sin6_addr = in6addr_loopback;
    }
    socklen_t length = family == AF_INET ? sizeof(sockaddr_in) : sizeof(sockaddr_in6);
    if (bind(listener, reinterpret_cast<sockaddr*>(&name), length) != 0) continue;  // no IPv6 here
    ASSERT_EQ(listen(listener, 1), 0);
    getsockname(listener, reinterpret_cast<sockaddr*>(&name), &length);
    const int client = socket(family, SOCK_STREAM, 0);
    ASSERT_EQ(connect(client, reinterpret_cast<sockaddr*>(&name), length), 0);
    const int server = accept(listener, nullptr, nullptr);
    const int port = ntohs(family == AF_INET ? reinterpret_cast<sockaddr_in&>(name).sin_port
                                             : reinterpret_cast<sockaddr_in6&>(name).sin6_port);
    // The client's socket is of this process too: its peer is the listener.
    const std::string host = family == AF_INET ? "ipv4:127.0.0.1:" : "ipv6:%5B::1%5D:";
    EXPECT_FALSE(ShutDownConnection(absl::StrCat(host, 1)));
    EXPECT_TRUE(ShutDownConnection(absl::StrCat(host, port)));
    char byte;
    EXPECT_EQ(recv(server, &byte, 1, 0), 0);
    for (const int file : {listener, client, server}) close(file);
  }
  EXPECT_FALSE(ShutDownConnection("unix:"));
  EXPECT_FALSE(ShutDownConnection("ipv4:127.0.0.1"));
}

}  // namespace
}  // namespace deltaray
