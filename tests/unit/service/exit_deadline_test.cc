#include "server/service/exit_deadline.h"

#include <cstdlib>

#include "gtest/gtest.h"

namespace deltaray {
namespace {

TEST(ExitDeadlineTest, DoesNothingWhereAllEndsInTime) {
  for (int i = 0; i < 100; ++i) ExitDeadline deadline(std::chrono::seconds(60), 1);
}

TEST(ExitDeadlineDeathTest, EndsTheProcessWhereSomethingHangs) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(
      {
        ExitDeadline deadline(std::chrono::milliseconds(50), 3);
        std::this_thread::sleep_for(std::chrono::seconds(60));
      },
      testing::ExitedWithCode(3), "");
}

}  // namespace
}  // namespace deltaray
