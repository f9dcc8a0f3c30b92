#include "server/store/folder_watch.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <string>

#include "tests/unit/store/fixture.h"

namespace deltaray {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

class FolderWatchTest : public ::testing::Test {
 protected:
  std::string Path(char digit) const { return directory_.path() + "/" + std::string(64, digit) + ".mesh"; }
  FolderWatch::Changes Look() { return *watch_.Look(now_); }
  // Gives the folder the time of change that it had before, as a coarse clock would.
  template <typename Change>
  void ChangeUnseen(Change change) {
    struct stat before;
    ASSERT_EQ(stat(directory_.path().c_str(), &before), 0);
    change();
    const timespec times[] = {before.st_atim, before.st_mtim};
    ASSERT_EQ(utimensat(AT_FDCWD, directory_.path().c_str(), times, 0), 0);
  }

  // Gives the folder an old time of change.
  void MakeOld() {
    const timespec times[] = {{.tv_sec = 1, .tv_nsec = 0}, {.tv_sec = 1, .tv_nsec = 0}};
    ASSERT_EQ(utimensat(AT_FDCWD, directory_.path().c_str(), times, 0), 0);
  }

  ScratchDirectory directory_;
  FolderWatch watch_{directory_.path(), ".mesh"};
  FolderWatch::Clock::time_point now_ = FolderWatch::Clock::now();
  const std::string a_ = std::string(64, 'a'), b_ = std::string(64, 'b');
};

TEST_F(FolderWatchTest, TellsWhatIsNewAndWhatIsGone) {
  WriteFile(Path('a'), "1");
  WriteFile(directory_.path() + "/README", "foreign");
  EXPECT_THAT(Look().present, ElementsAre(a_));
  WriteFile(Path('b'), "1");
  EXPECT_THAT(Look().present, ElementsAre(a_, b_));  // a is young
  now_ += FolderWatch::kSettle;
  EXPECT_THAT(Look().present, IsEmpty());
  MakeOld();  // else a coarse clock might show no change
  std::filesystem::remove(Path('a'));
  EXPECT_THAT(Look().gone, ElementsAre(a_));
  EXPECT_THAT(Look().gone, IsEmpty());
  WriteFile(Path('c'), "1");
  std::filesystem::rename(Path('c'), Path('b'));
  EXPECT_THAT(Look().present, ElementsAre(b_));
}

TEST_F(FolderWatchTest, WhatChangesRightAfterALookIsNoticed) {
  WriteFile(Path('a'), "1");
  EXPECT_THAT(Look().present, ElementsAre(a_));
  ChangeUnseen([&] { WriteFile(Path('b'), "1"); });
  now_ += FolderWatch::kSettle / 2;
  EXPECT_THAT(Look().present, ElementsAre(a_, b_));
}

TEST_F(FolderWatchTest, AnErrorHidesNothing) {
  WriteFile(Path('a'), "1");
  const std::string away = directory_.path() + "_away";
  std::filesystem::rename(directory_.path(), away);
  EXPECT_EQ(watch_.Look(now_).status().code(), absl::StatusCode::kFailedPrecondition);
  std::filesystem::rename(away, directory_.path());
  EXPECT_THAT(Look().present, ElementsAre(a_));
  std::filesystem::rename(directory_.path(), away);
  EXPECT_FALSE(watch_.Look(now_).ok());
  std::filesystem::rename(away, directory_.path());
  EXPECT_THAT(Look().gone, IsEmpty());
}

TEST_F(FolderWatchTest, TellsAgainOfWhatCouldNotBeRead) {
  WriteFile(Path('a'), "1");
  Look();
  now_ += FolderWatch::kSettle;
  Look();
  now_ += FolderWatch::kSettle;
  EXPECT_THAT(Look().present, IsEmpty());
  watch_.TellOf(a_);
  EXPECT_THAT(Look().present, ElementsAre(a_));
  EXPECT_THAT(Look().present, IsEmpty());
}

}  // namespace
}  // namespace deltaray
