#include "server/store/change_lock.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <string>
#include <thread>

#include "tests/unit/store/fixture.h"

namespace deltaray {
namespace {

using ::testing::HasSubstr;
using Clock = std::chrono::steady_clock;

class ChangeLockTest : public ::testing::Test {
 protected:
  static constexpr std::chrono::milliseconds kTimeout{1000};

  absl::StatusOr<DataDirectory> Open() {
    DataDirectory::Changes contents;
    return DataDirectory::Open(scratch_.path(), kTimeout, &contents);
  }
  // Waits in vain, and tells for how long.
  Clock::duration Fail(const std::string& text) {
    const Clock::time_point begin = Clock::now();
    const absl::Status status = lock_.Take().status();
    EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable) << status;
    EXPECT_THAT(std::string(status.message()), HasSubstr(text));
    return Clock::now() - begin;
  }

  ScratchDirectory scratch_;
  const absl::StatusOr<DataDirectory> directory_ = Open();
  ChangeLock lock_{&*directory_, kTimeout};
};

TEST_F(ChangeLockTest, TheShortWaitAfterALongOneIsForgotten) {
  const absl::StatusOr<FileDescriptor> other = directory_->Lock(kTimeout);
  ASSERT_TRUE(other.ok());
  EXPECT_GE(
      Fail("another process, a server or a back-up, holds the lock " + scratch_.path() + "/lock; waited for 1000 ms"),
      kTimeout);
  EXPECT_LT(Fail("; waited for 10 ms"), kTimeout / 2);
  std::this_thread::sleep_for(kTimeout);
  EXPECT_GE(Fail("; waited for 1000 ms"), kTimeout);
}

TEST_F(ChangeLockTest, WhatWasSpentOnThisServersChangesTellsNothingOfOthers) {
  {
    absl::StatusOr<ChangeLock::Held> held = lock_.Take();
    ASSERT_TRUE(held.ok());
    std::thread waiting([&] { EXPECT_GE(Fail("; waited for 1000 ms"), kTimeout); });
    // It gets the turn late, and then finds the file locked: another file, which nobody can take in between.
    std::this_thread::sleep_for(kTimeout / 2);
    ASSERT_TRUE(RemoveFile(scratch_.path() + "/lock").ok());
    const absl::StatusOr<FileDescriptor> other = directory_->Lock(kTimeout);
    EXPECT_TRUE(other.ok());
    { const ChangeLock::Held given_back = *std::move(held); }
    waiting.join();
  }
  const absl::StatusOr<FileDescriptor> other = directory_->Lock(kTimeout);
  ASSERT_TRUE(other.ok());
  EXPECT_GE(Fail("; waited for 1000 ms"), kTimeout);
}

}  // namespace
}  // namespace deltaray
