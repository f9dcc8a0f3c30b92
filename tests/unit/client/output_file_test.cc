#include "client/output_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "client/exit_code.h"
#include "tests/hindered.h"

namespace deltaray {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// Each test has a folder of its own, and `path_` in it.
class OutputFileTest : public ::testing::Test {
 protected:
  OutputFileTest() {
    char folder[] = "/tmp/deltaray_output_test_XXXXXX";
    folder_ = mkdtemp(folder);
    path_ = folder_ / "picture";
  }
  ~OutputFileTest() override { std::filesystem::remove_all(folder_); }

  std::string Read() const {
    std::ifstream file(path_, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(file), {});
  }

  std::vector<std::string> Names() const {
    std::vector<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(folder_)) names.push_back(entry.path().filename());
    std::sort(names.begin(), names.end());
    return names;
  }

  std::filesystem::path folder_;
  std::filesystem::path path_;
};

TEST_F(OutputFileTest, MakesAndReplacesFiles) {
  ASSERT_TRUE(WriteWholeFile(path_, "old").ok());
  EXPECT_EQ(Read(), "old");
  chmod(path_.c_str(), 0640);
  ASSERT_TRUE(WriteWholeFile(path_, "a new one").ok());
  EXPECT_EQ(Read(), "a new one");
  struct stat info;
  ASSERT_EQ(stat(path_.c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 07777, 0640u);
  EXPECT_THAT(Names(), ElementsAre("picture"));
}

TEST_F(OutputFileTest, AFailureLeavesTheOldFile) {
  const FileSizeLimit limit(1000);
  const std::string data(5000, 'x');
  EXPECT_THAT(std::string(WriteWholeFile(path_, data).message()), HasSubstr("/picture: File too large"));
  EXPECT_THAT(Names(), IsEmpty());
  ASSERT_TRUE(WriteWholeFile(path_, "old").ok());
  EXPECT_EQ(ExitCode(WriteWholeFile(path_, data)), 1);
  EXPECT_EQ(Read(), "old");
  EXPECT_THAT(Names(), ElementsAre("picture"));
}

TEST_F(OutputFileTest, LinksStay) {
  std::ofstream(folder_ / "file") << "old";
  std::filesystem::create_symlink("file", path_);
  ASSERT_TRUE(WriteWholeFile(path_, "new").ok());
  EXPECT_TRUE(std::filesystem::is_symlink(path_));
  EXPECT_EQ(Read(), "new");
}

TEST_F(OutputFileTest, DevicesAndPipesAreWrittenTo) {
  ASSERT_TRUE(WriteWholeFile("/dev/null", "x").ok());
  EXPECT_TRUE(std::filesystem::is_character_file("/dev/null"));

  int pipe_ends[2];
  ASSERT_EQ(pipe(pipe_ends), 0);
  ASSERT_TRUE(WriteWholeFile("/dev/fd/" + std::to_string(pipe_ends[1]), "x").ok());
  char byte = 0;
  EXPECT_EQ(read(pipe_ends[0], &byte, 1), 1);
  EXPECT_EQ(byte, 'x');
  close(pipe_ends[0]);
  close(pipe_ends[1]);
}

TEST_F(OutputFileTest, TellsWhichFileCannotBeWritten) {
  EXPECT_EQ(WriteWholeFile("/no/such/picture", "x").message(),
            "cannot write /no/such/picture: No such file or directory");
  EXPECT_THAT(std::string(WriteWholeFile(folder_, "x").message()), HasSubstr("Is a directory"));
}

}  // namespace
}  // namespace deltaray
