#include "server/service/listener.h"

#include <fcntl.h>
#include <netinet/in.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using grpc::StatusCode;
using testing::HasSubstr;

class ListenerTest : public RunningServer {
 protected:
  // A call on a connection of its own.
  grpc::Status List(const std::shared_ptr<grpc::Channel>& channel) {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(10));
    v1::ListMeshesResponse list;
    return v1::MeshService::NewStub(channel)->ListMeshes(&context, {}, &list);
  }
};

TEST_F(ListenerTest, RefusesConnectionsOverTheLimitUntilOneIsClosed) {
  options_.max_connections = 3;
  Start();
  std::vector<std::shared_ptr<grpc::Channel>> channels = {Connect(), Connect(), Connect()};
  for (const auto& channel : channels) ASSERT_TRUE(List(channel).ok());
  const grpc::Status refused = List(Connect());
  EXPECT_EQ(refused.error_code(), StatusCode::UNAVAILABLE);
  for (const auto& channel : channels) EXPECT_TRUE(List(channel).ok());
  channels.pop_back();
  EXPECT_TRUE(Eventually([&] { return List(Connect()).ok(); }));
}

TEST_F(ListenerTest, ServesAUnixSocket) {
  const std::string path = directory_ + "/socket";
  options_.listen = "unix:" + path;
  Start();
  EXPECT_EQ(server_->port(), 0);
  EXPECT_TRUE(List(grpc::CreateChannel(options_.listen, grpc::InsecureChannelCredentials())).ok());
  // Neither is a server that listens shut out by another one, nor is one by what is left of a dead one.
  ServerOptions options = options_;
  options.store.data_directory = directory_ + "/other";
  EXPECT_EQ(Server::Start(options).status().code(), absl::StatusCode::kUnavailable);
  EXPECT_TRUE(List(grpc::CreateChannel(options_.listen, grpc::InsecureChannelCredentials())).ok());
  server_.reset();
  EXPECT_FALSE(std::filesystem::exists(path));
}

TEST_F(ListenerTest, AUnixSocketWhoseOwnerAcceptsNobodyIsInUse) {
  const std::string path = directory_ + "/socket";
  sockaddr_un name{};
  name.sun_family = AF_UNIX;
  ASSERT_LT(path.size(), sizeof(name.sun_path));
  path.copy(name.sun_path, path.size());
  const auto* const any_name = reinterpret_cast<const sockaddr*>(&name);
  std::vector<int> files = {socket(AF_UNIX, SOCK_STREAM, 0)};
  ASSERT_EQ(bind(files[0], any_name, sizeof(name)), 0);
  ASSERT_EQ(listen(files[0], 0), 0);
  do {
    files.push_back(socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0));
  } while (connect(files.back(), any_name, sizeof(name)) == 0);
  EXPECT_EQ(errno, EAGAIN);
  const auto listener = Listener::Open("unix:" + path, 1);
  EXPECT_EQ(listener.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(listener.status().message()), HasSubstr("in use"));
  EXPECT_TRUE(std::filesystem::exists(path));
  for (const int file : files) close(file);
}

TEST_F(ListenerTest, AddressesThatCanNotBeHadAreNamed) {
  for (const char* address : {"192.0.2.1:0", "no-such-host.invalid:0", "unix:/no/such/directory/socket"}) {
    const auto listener = Listener::Open(address, 1);
    EXPECT_EQ(listener.status().code(), absl::StatusCode::kUnavailable);
    EXPECT_THAT(std::string(listener.status().message()), HasSubstr(address));
  }
}

// gRPC's own listener never listened again.
TEST_F(ListenerTest, ListensAgainAfterFileDescriptorsRanOut) {
#ifdef DELTARAY_SANITIZED
  GTEST_SKIP() << "UndefinedBehaviorSanitizer takes two file descriptors to look at an object";
#endif
  Start();
  ASSERT_TRUE(List(Connect()).ok());
  rlimit limit;
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &limit), 0);
  const rlimit low = {std::min<rlim_t>(limit.rlim_cur, 512), limit.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &low), 0);
  // The client's end is there before none are left.
  std::vector<int> files = {socket(AF_INET, SOCK_STREAM, 0)};
  for (int file; (file = open("/dev/null", O_RDONLY)) >= 0;) files.push_back(file);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<uint16_t>(server_->port()));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  ASSERT_EQ(connect(files[0], reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  for (const int file : files) close(file);
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &limit), 0);
  EXPECT_TRUE(Eventually([&] { return List(Connect()).ok(); }));
}

}  // namespace
}  // namespace deltaray
