// What holds for every command: the server's address, usage errors, help.

#include "client/command_line.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <utility>

#include "tests/unit/client/fake_server.h"
#include "tests/unit/client/test_session.h"

namespace deltaray {
namespace {

using ::testing::HasSubstr;
using ::testing::MatchesRegex;
using ::testing::StartsWith;

TEST(CommandLineTest, ServerThatIsNotThere) {
  TestSession session("127.0.0.1:1");
  EXPECT_EQ(session.Run({"list"}), 64 + 14);
  EXPECT_EQ(session.TakeMessages(),
            "deltaray: cannot reach deltarayd at 127.0.0.1:1: no server answers there (UNAVAILABLE)\n");
}

// No name server has to be asked of these.
TEST(CommandLineTest, NameThatCannotBeResolved) {
  for (const char* const name : {"grpc_proxy", "https_proxy", "http_proxy"}) unsetenv(name);
  TestSession session("no..name:1");
  EXPECT_EQ(session.Run({"list"}), 64 + 14);
  EXPECT_EQ(session.TakeMessages(),
            "deltaray: cannot reach deltarayd at no..name:1: its name cannot be resolved (UNAVAILABLE)\n");
  // With a proxy, gRPC asks for its name instead.
  setenv("http_proxy", "http://no..proxy:1", 1);
  EXPECT_EQ(session.Run({"list"}), 64 + 14);
  EXPECT_EQ(session.TakeMessages(),
            "deltaray: cannot reach deltarayd at no..name:1: its name, or that of the proxy in http_proxy, cannot be "
            "resolved (UNAVAILABLE)\n");
  unsetenv("http_proxy");
}

TEST(CommandLineTest, ThatNobodyListensIsToldAtOnce) {
  const auto is_soon = [] {
    const auto start = std::chrono::steady_clock::now();
    EXPECT_EQ(TestSession("127.0.0.1:1").Run({"list"}), 64 + 14);
    return std::chrono::steady_clock::now() - start < std::chrono::seconds(2);
  };
  // In one of a few tries, on a busy machine.
  EXPECT_TRUE(is_soon() || is_soon() || is_soon());
}

TEST(CommandLineTest, ServerThatDoesNotAnswer) {
  FakeServer server;
  server.behaviour.list_delay_ms = 4000;
  TestSession session(server.address());
  EXPECT_EQ(session.Run({"list", "--timeout", "1.5"}), 64 + 4);
  EXPECT_EQ(session.TakeMessages(), "deltaray: no answer within 1.5 s; see --timeout (DEADLINE_EXCEEDED)\n");
}

TEST(CommandLineTest, ServerComesFromFlagThenEnvironment) {
  FakeServer server;
  TestSession session("127.0.0.1:1");
  EXPECT_EQ(session.Run({"list", "--server", server.address()}), 0);
  TestSession before("127.0.0.1:1");
  EXPECT_EQ(before.Run({"--server", server.address(), "list"}), 0);
  setenv("DELTARAY_SERVER", server.address().c_str(), 1);
  TestSession environment("127.0.0.1:1");
  EXPECT_EQ(environment.Run({"list"}), 0);
  TestSession flag("127.0.0.1:1");
  EXPECT_EQ(flag.Run({"--server", "127.0.0.1:1", "list"}), 64 + 14);
  unsetenv("DELTARAY_SERVER");
}

TEST(CommandLineTest, UsageErrors) {
  TestSession session;
  EXPECT_EQ(session.Run({}), 2);
  EXPECT_EQ(session.Run({"fly"}), 2);
  EXPECT_EQ(session.Run({"show"}), 2);
  EXPECT_EQ(session.Run({"list", "--format", "xml"}), 2);
  EXPECT_EQ(session.Run({"list", "--timeout", "0"}), 2);
  EXPECT_EQ(session.Run({"health", ""}), 2);
  EXPECT_EQ(session.TakeOutput(), "");
  EXPECT_THAT(session.TakeMessages(), HasSubstr("There is no command 'fly'"));
  EXPECT_EQ(session.Run({"--server", "somewhere", "list"}), 2);
  EXPECT_THAT(session.TakeMessages(), HasSubstr("--server: 'somewhere' has no port"));
}

// gRPC takes the digits that a port begins with, and of the number its last 16 bits: a slip reached another server.
TEST(CommandLineTest, RefusesPortsThatAreNone) {
  TestSession session;
  for (const std::string port :
       {"7999x", "7999abc", "073535", "79999", "65536", "-1", "+1", "0", " 1", "", "http", "99999999999999999999"}) {
    for (const char* const host : {"127.0.0.1:", "dns:///localhost:", "dns:localhost:", "ipv4:127.0.0.1:",
                                   "ipv4:127.0.0.1:1,127.0.0.1:", "[::1]:", "ipv6:[::1]:", "ipv6:%5B::1%5D:"}) {
      EXPECT_EQ(session.Run({"--server", host + port, "list"}), 2) << host << port;
      EXPECT_THAT(session.TakeMessages(),
                  StartsWith("--server: '" + (host + port) + "': port '" + port + "' is not in the range 1 to 65535"));
    }
  }
  for (const char* const address : {"dns:///localhost", "dns:", "ipv4:127.0.0.1", "ipv4:127.0.0.1:1,127.0.0.1", "::1",
                                    "[::1]", "dns://127.0.0.1:53/localhost"}) {
    EXPECT_EQ(session.Run({"--server", address, "list"}), 2) << address;
    EXPECT_THAT(session.TakeMessages(), HasSubstr(" has no port"));
  }
  setenv("DELTARAY_SERVER", "localhost:79999", 1);
  TestSession environment;
  EXPECT_EQ(environment.Run({"list"}), 2);
  EXPECT_THAT(environment.TakeMessages(), HasSubstr("port '79999' is not in the range"));
  unsetenv("DELTARAY_SERVER");
}

TEST(CommandLineTest, TakesEverySchemeOfAddress) {
  FakeServer server;
  const std::string port = server.address().substr(server.address().rfind(':'));
  for (const std::string host : {"localhost", "dns:localhost", "dns:///localhost", "ipv4:127.0.0.1",
                                 "ipv4:///127.0.0.1", "ipv4:127.0.0.1:1,127.0.0.1"}) {
    TestSession session;
    EXPECT_EQ(session.Run({"--server", host + port, "list"}), 0) << host << session.TakeMessages();
  }
  // Nobody listens there.
  for (const char* const address : {"unix:/no/such:socket", "unix-abstract:deltaray-no-such", "[::1]:1", "ipv6:[::1]:1",
                                    "ipv6:%5B::1%5D:1", "127.0.0.1:65535"}) {
    TestSession session;
    EXPECT_EQ(session.Run({"--server", address, "list"}), 64 + 14) << address;
  }
}

TEST(CommandLineTest, EveryHelpHasAnExample) {
  TestSession session;
  EXPECT_EQ(session.Run({"--help"}), 0);
  EXPECT_THAT(session.TakeOutput(), HasSubstr("deltaray upload bunny.obj"));
  for (const char* command :
       {"upload", "list", "show", "name", "watch", "stats", "rebuild", "delete", "cast", "render"}) {
    EXPECT_EQ(session.Run({command, "--help"}), 0) << command;
    EXPECT_THAT(session.TakeOutput(), HasSubstr(std::string("  deltaray ") + command)) << command;
  }
  EXPECT_EQ(session.Run({"--version"}), 0);
  EXPECT_THAT(session.TakeOutput(), MatchesRegex("deltaray [0-9.]+\n"));
}

TEST(CommandLineTest, HelpThatCannotBeWrittenFails) {
  TestSession session;
  std::FILE* full = std::fopen("/dev/full", "w");
  ASSERT_NE(full, nullptr);
  std::swap(session.session().output, full);
  for (const char* const flag : {"--help", "--version"}) {
    EXPECT_EQ(session.Run({flag}), 1);
    EXPECT_EQ(session.TakeMessages(), "deltaray: cannot write standard output: No space left on device\n");
    std::clearerr(session.session().output);
  }
  std::swap(session.session().output, full);
  std::fclose(full);
}

}  // namespace
}  // namespace deltaray
