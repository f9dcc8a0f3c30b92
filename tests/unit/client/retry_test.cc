#include "client/retry.h"

#include <chrono>

#include "gtest/gtest.h"
#include "tests/unit/client/test_session.h"

namespace deltaray {
namespace {

const grpc::Status kLost(grpc::StatusCode::UNAVAILABLE, "lost");

TEST(RetryTest, OnlyALostServerIsALoss) {
  EXPECT_TRUE(IsLoss(kLost));
  EXPECT_TRUE(IsLoss({grpc::StatusCode::INTERNAL, "Received RST_STREAM with error code 2"}));
  EXPECT_FALSE(IsLoss({grpc::StatusCode::INTERNAL, "a defect"}));
  EXPECT_FALSE(IsLoss({grpc::StatusCode::RESOURCE_EXHAUSTED, "too much"}));
  EXPECT_FALSE(IsLoss({grpc::StatusCode::DEADLINE_EXCEEDED, "late"}));
  EXPECT_FALSE(IsLoss(grpc::Status::OK));
}

TEST(RetryTest, EndsAfterItsTimeWhichASuccessBeginsAnew) {
  TestSession session;
  session.session().retry_seconds = 1;
  Retry retry(session.session());
  const auto begin = std::chrono::steady_clock::now();
  int tries = 0;
  while (retry.Again(kLost)) ++tries;
  EXPECT_GE(tries, 2);
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(5));
  EXPECT_FALSE(retry.Again(kLost));
  retry.Succeeded();
  EXPECT_TRUE(retry.Again(kLost));
}

TEST(RetryTest, NeverWithoutTimeOrAfterAStop) {
  TestSession session;
  EXPECT_FALSE(Retry(session.session()).Again(kLost));
  session.session().retry_seconds = 3600;
  session.stop.Fire();
  EXPECT_FALSE(Retry(session.session()).Again(kLost));
}

}  // namespace
}  // namespace deltaray
