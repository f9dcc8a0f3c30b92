#include "client/connection.h"

#include <cstdlib>

#include "client/exit_code.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/unit/client/fake_server.h"
#include "tests/unit/client/test_session.h"

namespace deltaray {
namespace {

using testing::HasSubstr;

class ConnectionTest : public ::testing::Test {
 protected:
  ConnectionTest() : session_(server_.address()) {}

  // The metadata that a stream about `mesh` arrives with.
  std::multimap<std::string, std::string> MetadataOf(const std::string& mesh) {
    absl::StatusOr<Connection> connection = Connection::Open(session_.session());
    EXPECT_TRUE(connection.ok()) << connection.status();
    grpc::ClientContext context;
    connection->Prepare(mesh, &context);
    const auto stream = connection->rays().StreamRays(&context);
    v1::StreamRaysRequest start;
    start.mutable_start()->set_mesh(mesh);
    stream->Write(start);
    stream->WritesDone();
    EXPECT_TRUE(stream->Finish().ok());
    return server_.ray_service.last_metadata;
  }

  FakeServer server_;
  TestSession session_;
};

TEST_F(ConnectionTest, CallsThatReadAreMadeAgainWhileTheServerIsLost) {
  session_.session().retry_seconds = 20;
  server_.behaviour.list_failures = 3;
  EXPECT_EQ(session_.Run({"list"}), 0) << session_.TakeMessages();
}

// As gRPC answers what comes while it shuts down.
TEST_F(ConnectionTest, WhatTheServerCancelsIsLost) {
  TemporaryFile file("v 0 0 0");
  ASSERT_EQ(session_.Run({"upload", file.path(), "--format", "obj", "--name", "bunny"}), 0);
  server_.behaviour.lost = grpc::Status::CANCELLED;
  session_.session().retry_seconds = 20;
  server_.behaviour.list_failures = 2;
  EXPECT_EQ(session_.Run({"list"}), 0) << session_.TakeMessages();
  server_.behaviour.watch_failures = 2;
  EXPECT_EQ(session_.Run({"watch", "bunny"}), 0) << session_.TakeMessages();
  // Told apart from an interrupt where it is not made again.
  server_.behaviour.delete_failures = 1;
  EXPECT_EQ(session_.Run({"delete", "bunny"}), 78);
  EXPECT_THAT(session_.TakeMessages(), HasSubstr("the server ended"));
}

TEST_F(ConnectionTest, CallsThatReadAreMadeOnceWithoutRetries) {
  server_.behaviour.list_failures = 1;
  EXPECT_EQ(session_.Run({"list"}), 78);
  server_.behaviour.list_failures = 1;
  EXPECT_EQ(session_.Run({"--retry-for", "20", "list"}), 0);
}

TEST_F(ConnectionTest, CallsThatChangeAreMadeOnce) {
  session_.session().retry_seconds = 20;
  server_.behaviour.delete_failures = 1;
  EXPECT_EQ(session_.Run({"delete", "bunny"}), 78);
  EXPECT_EQ(server_.behaviour.delete_failures, 0);
}

TEST_F(ConnectionTest, HealthIsAskedOnce) {
  session_.session().retry_seconds = 20;
  server_.behaviour.health_failures = 1;
  EXPECT_EQ(session_.Run({"health"}), 78);
  EXPECT_EQ(server_.behaviour.health_failures, 0);
  EXPECT_EQ(session_.Run({"health"}), 0);
  EXPECT_EQ(session_.TakeOutput(), "SERVING\n");
}

TEST_F(ConnectionTest, WatchesAreResumed) {
  session_.session().retry_seconds = 20;
  TemporaryFile file("v 0 0 0");
  ASSERT_EQ(session_.Run({"upload", file.path(), "--format", "obj", "--name", "bunny"}), 0);
  server_.behaviour.watch_failures = 2;
  EXPECT_EQ(session_.Run({"watch", "bunny"}), 0) << session_.TakeMessages();
  session_.session().retry_seconds = 0;
  server_.behaviour.watch_failures = 1;
  EXPECT_EQ(session_.Run({"watch", "bunny"}), 78);
}

TEST_F(ConnectionTest, OnlyUploadsOfFilesWithoutANameAreRepeated) {
  session_.session().retry_seconds = 20;
  server_.behaviour.upload_status = grpc::Status(grpc::StatusCode::UNAVAILABLE, "lost");
  TemporaryFile file("v 0 0 0");
  server_.behaviour.upload_failures = 2;
  EXPECT_EQ(session_.Run({"upload", file.path(), "--format", "obj"}), 0) << session_.TakeMessages();
  EXPECT_EQ(server_.mesh_service.last_upload, "v 0 0 0");
  server_.behaviour.upload_failures = 1;
  EXPECT_EQ(session_.Run({"upload", file.path(), "--format", "obj", "--name", "bunny"}), 78);
  server_.behaviour.upload_failures = 1;
  session_.SetInput("v 0 0 0");
  EXPECT_EQ(session_.Run({"upload", "-", "--format", "obj"}), 78);
}

TEST_F(ConnectionTest, ProxiesWithoutAServerAreToldApart) {
  absl::StatusOr<Connection> connection = Connection::Open(session_.session());
  ASSERT_TRUE(connection.ok()) << connection.status();
  const grpc::Status status(grpc::StatusCode::UNAVAILABLE, "Received http2 header with status: 502");
  EXPECT_EQ(connection->Result(status).message(), "Received http2 header with status: 502; a proxy answered at " +
                                                      server_.address() + ", and no server behind it");
  EXPECT_EQ(ExitCode(connection->Result(status)), 78);
}

// Else a token in plaintext would leave the machine. At port 1 there is no proxy.
TEST_F(ConnectionTest, NoProxyIsAskedForThisMachine) {
  setenv("http_proxy", "http://127.0.0.1:1", 1);
  EXPECT_EQ(session_.Run({"list"}), 0) << session_.TakeMessages();
  unsetenv("http_proxy");
}

TEST_F(ConnectionTest, EachCallCarriesItsMeshAsPrintableText) {
  EXPECT_EQ(MetadataOf("bunny").find("deltaray-mesh")->second, "bunny");
  EXPECT_EQ(MetadataOf("50% bünny").find("deltaray-mesh")->second, "50%25%20b%C3%BCnny");
}

TEST_F(ConnectionTest, SendsTheTokenOfTheEnvironmentOrOfAFile) {
  EXPECT_FALSE(MetadataOf("bunny").contains("authorization"));
  session_.session().security.token = "abc";
  EXPECT_EQ(MetadataOf("bunny").find("authorization")->second, "Bearer abc");
  TemporaryFile file(" def \nghi\n");
  session_.session().security.token_file = file.path();
  EXPECT_EQ(MetadataOf("bunny").find("authorization")->second, "Bearer def");
}

TEST_F(ConnectionTest, TokensThatNoHeaderCanHoldAreRefused) {
  TemporaryFile empty("\n");
  session_.session().security.token_file = empty.path();
  EXPECT_THAT(std::string(Connection::Open(session_.session()).status().message()), HasSubstr("first line is empty"));
  TemporaryFile blank("a b");
  session_.session().security.token_file = blank.path();
  EXPECT_THAT(std::string(Connection::Open(session_.session()).status().message()), HasSubstr("printable ASCII"));
}

TEST(SecurityFlagsTest, TokensInPlaintextToOtherMachinesMustBeMeant) {
  SecurityFlags flags;
  flags.token = "abc";
  for (const char* here : {"127.0.0.1:1", "localhost:1", "[::1]:1", "unix:/tmp/socket"}) {
    EXPECT_TRUE(ReadToken(flags, here).ok()) << here;
  }
  for (const char* other :
       {"192.0.2.1:1", "example.com:1", "localhost.example.com:1", "127.example.com:1", "[2001:db8::1]:1"}) {
    EXPECT_EQ(ExitCode(ReadToken(flags, other).status()), 2) << other;
  }
  flags.insecure_token = true;
  EXPECT_TRUE(ReadToken(flags, "192.0.2.1:1").ok());
  flags = {.tls = true, .token = "abc"};
  EXPECT_TRUE(ReadToken(flags, "192.0.2.1:1").ok());
}

}  // namespace
}  // namespace deltaray
