// What the tests of commands share: a fake server, and a session with it.

#ifndef TESTS_UNIT_CLIENT_COMMANDS_FIXTURE_H_
#define TESTS_UNIT_CLIENT_COMMANDS_FIXTURE_H_

#include <gtest/gtest.h>

#include <string>

#include "tests/unit/client/fake_server.h"
#include "tests/unit/client/test_session.h"

namespace deltaray {

class CommandsTest : public ::testing::Test {
 protected:
  CommandsTest() : session_(server_.address()) {}

  // Puts a mesh of bounds -1 to 1 on the server.
  std::string AddMesh(const std::string& name) {
    TestSession session(server_.address());
    session.SetInput("v");
    EXPECT_EQ(session.Run({"upload", "-", "--name", name}), 0);
    std::string id = session.TakeOutput();
    id.pop_back();
    return id;
  }

  FakeServer server_;
  TestSession session_;
};

}  // namespace deltaray

#endif  // TESTS_UNIT_CLIENT_COMMANDS_FIXTURE_H_
