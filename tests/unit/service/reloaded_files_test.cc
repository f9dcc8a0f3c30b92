#include "server/service/reloaded_files.h"

#include <stdlib.h>
#include <sys/stat.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <thread>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace deltaray {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

class ReloadedFilesTest : public testing::Test {
 protected:
  ReloadedFilesTest() {
    std::string pattern = testing::TempDir() + "/deltaray_reloaded_XXXXXX";
    directory_ = mkdtemp(pattern.data());
    Write("one", "1");
    Write("two", "2");
  }
  ~ReloadedFilesTest() override {
    files_.reset();
    std::filesystem::remove_all(directory_);
  }

  void Write(const std::string& name, const std::string& bytes) { std::ofstream(directory_ / name) << bytes; }

  absl::Status Start() {
    auto files = ReloadedFiles::Start({{"first", directory_ / "one", {}}, {"second", directory_ / "two", {}}},
                                      [this](const std::vector<ReloadedFile>& files) {
                                        MutexLock lock(mutex_);
                                        if (files[0].bytes == "bad") return files[0].Error("is bad");
                                        loads_.push_back(files[0].bytes + files[1].bytes);
                                        return absl::OkStatus();
                                      });
    if (!files.ok()) return files.status();
    files_ = *std::move(files);
    return absl::OkStatus();
  }

  std::vector<std::string> Loads() {
    MutexLock lock(mutex_);
    return loads_;
  }
  void WaitForLoads(size_t count) {
    for (int i = 0; i < 1000 && Loads().size() < count; ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  // Long enough for a change to be seen.
  static void WaitForLooks() { std::this_thread::sleep_for(std::chrono::milliseconds(1600)); }

  std::filesystem::path directory_;
  Mutex mutex_;
  std::vector<std::string> loads_;
  std::unique_ptr<ReloadedFiles> files_;
};

TEST_F(ReloadedFilesTest, LoadsAtOnceAndWhenAFileChanges) {
  ASSERT_TRUE(Start().ok());
  EXPECT_THAT(Loads(), ElementsAre("12"));
  Write("two", "3");
  WaitForLoads(2);
  WaitForLooks();
  EXPECT_THAT(Loads(), ElementsAre("12", "13"));
}

TEST_F(ReloadedFilesTest, SeesWhereALinkLeadsNow) {
  for (const char* version : {"a", "b"}) {
    std::filesystem::create_directory(directory_ / version);
    std::ofstream(directory_ / version / "file") << version;
  }
  std::filesystem::remove(directory_ / "one");
  std::filesystem::create_directory_symlink("a", directory_ / "now");
  std::filesystem::create_symlink("now/file", directory_ / "one");
  ASSERT_TRUE(Start().ok());
  std::filesystem::create_directory_symlink("b", directory_ / "next");
  std::filesystem::rename(directory_ / "next", directory_ / "now");
  WaitForLoads(2);
  EXPECT_THAT(Loads(), ElementsAre("a2", "b2"));
}

TEST_F(ReloadedFilesTest, GoesOnAfterFilesThatAreBadOrMissing) {
  ASSERT_TRUE(Start().ok());
  Write("one", "bad");
  WaitForLooks();
  std::filesystem::remove(directory_ / "two");
  WaitForLooks();
  EXPECT_THAT(Loads(), ElementsAre("12"));
  Write("one", "4");
  Write("two", "5");
  WaitForLoads(2);
  EXPECT_THAT(Loads(), ElementsAre("12", "45"));
}

TEST_F(ReloadedFilesTest, IsNotHeldUpByAFifo) {
  ASSERT_TRUE(Start().ok());
  std::filesystem::remove(directory_ / "two");
  ASSERT_EQ(mkfifo((directory_ / "two").c_str(), 0600), 0);
  WaitForLooks();
  std::filesystem::remove(directory_ / "two");
  Write("two", "5");
  WaitForLoads(2);
  EXPECT_THAT(Loads(), ElementsAre("12", "15"));
}

TEST_F(ReloadedFilesTest, DoesNotStartWithWhatItCanNotUse) {
  Write("one", "bad");
  EXPECT_THAT(std::string(Start().message()), HasSubstr("--first: " + (directory_ / "one").string() + ": is bad"));
  std::filesystem::remove(directory_ / "two");
  EXPECT_THAT(std::string(Start().message()), HasSubstr("--second: "));
  // Without end.
  std::filesystem::create_symlink("/dev/zero", directory_ / "two");
  EXPECT_THAT(std::string(Start().message()), HasSubstr("is not a regular file"));
  std::filesystem::remove(directory_ / "two");
  // Nobody writes to it.
  ASSERT_EQ(mkfifo((directory_ / "two").c_str(), 0600), 0);
  EXPECT_THAT(std::string(Start().message()), HasSubstr("is not a regular file"));
  std::filesystem::remove(directory_ / "two");
  Write("two", std::string(5 << 20, '2'));
  EXPECT_THAT(std::string(Start().message()), HasSubstr("has more than"));
  std::filesystem::remove(directory_ / "two");
  std::filesystem::create_directory(directory_ / "two");
  EXPECT_FALSE(Start().ok());
}

}  // namespace
}  // namespace deltaray
