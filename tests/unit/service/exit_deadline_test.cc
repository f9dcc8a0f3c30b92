#include "server/service/exit_deadline.h"

#include <cstdlib>

#include "gtest/gtest.h"
#include "tests/hindered.h"

namespace deltaray {
namespace {

TEST(ExitDeadlineTest, DoesNothingWhereAllEndsInTime) {
  for (int i = 0; i < 100; ++i) ExitDeadline deadline(1);
  for (int i = 0; i < 100; ++i) {
    ExitDeadline deadline(1);
    deadline.Begin(std::chrono::seconds(60));
  }
}

TEST(ExitDeadlineDeathTest, EndsTheProcessWhereSomethingHangs) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(
      {
        ExitDeadline deadline(3);
        deadline.Begin(std::chrono::milliseconds(50));
        std::this_thread::sleep_for(std::chrono::seconds(60));
      },
      testing::ExitedWithCode(3), "");
}

TEST(ExitDeadlineDeathTest, NeedsNoThreadWhenItBegins) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(
      {
        ExitDeadline deadline(3);
        ForbidThreads();
        deadline.Begin(std::chrono::milliseconds(50));
        std::this_thread::sleep_for(std::chrono::seconds(60));
      },
      testing::ExitedWithCode(3), "");
}

}  // namespace
}  // namespace deltaray
