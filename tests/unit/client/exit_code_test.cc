#include "client/exit_code.h"

#include <gtest/gtest.h>

namespace deltaray {
namespace {

TEST(ExitCodeTest, TellsKindsOfErrorsApart) {
  EXPECT_EQ(ExitCode(absl::OkStatus()), 0);
  EXPECT_EQ(ExitCode(LocalError("x")), 1);
  EXPECT_EQ(ExitCode(UsageError("x")), 2);
  EXPECT_EQ(ExitCode(Interrupted()), 65);
  // An error of none of our makers is a local one, whatever its code.
  EXPECT_EQ(ExitCode(absl::NotFoundError("x")), 1);
}

TEST(ExitCodeTest, AddsTheGrpcCode) {
  for (int code = 1; code <= 16; ++code) {
    EXPECT_EQ(ExitCode(FromRpc(grpc::Status(static_cast<grpc::StatusCode>(code), "x"))), 64 + code);
  }
  EXPECT_EQ(ExitCode(FromRpc(grpc::Status::OK)), 0);
}

TEST(ExitCodeTest, OutputClosedIsNoFailure) {
  EXPECT_EQ(ExitCode(OutputClosed()), 0);
  EXPECT_TRUE(IsOutputClosed(OutputClosed()));
  EXPECT_FALSE(OutputClosed().ok());
  EXPECT_FALSE(IsOutputClosed(absl::OkStatus()));
  EXPECT_FALSE(IsOutputClosed(LocalError("x")));
}

TEST(ExitCodeTest, TextHasTheServersCodeAndNoControlCharacters) {
  EXPECT_EQ(ErrorText(FromRpc(grpc::Status(grpc::StatusCode::NOT_FOUND, "no such mesh: a\nb"))),
            "no such mesh: a?b (NOT_FOUND)");
  EXPECT_EQ(ErrorText(LocalError("disk full")), "disk full");
}

}  // namespace
}  // namespace deltaray
