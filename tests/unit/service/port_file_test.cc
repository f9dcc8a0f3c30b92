#include "server/service/port_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace deltaray {
namespace {

namespace fs = std::filesystem;

// Each test has a folder of its own, and `path_` in it.
class PortFileTest : public ::testing::Test {
 protected:
  PortFileTest() {
    char folder[] = "/tmp/deltaray_port_file_test_XXXXXX";
    folder_ = mkdtemp(folder);
    path_ = folder_ / "port";
  }
  ~PortFileTest() override { fs::remove_all(folder_); }

  static std::string Line(const fs::path& path) {
    std::ifstream file(path);
    std::string line;
    std::getline(file, line);
    return line;
  }
  ptrdiff_t Files() const { return std::distance(fs::directory_iterator(folder_), {}); }

  fs::path folder_;
  fs::path path_;
};

TEST_F(PortFileTest, FilesAreMadeAndReplacedAsAWhole) {
  ASSERT_TRUE(WritePortFile(path_, 1234).ok());
  EXPECT_EQ(Line(path_), "1234");
  std::ifstream old(path_);
  ASSERT_TRUE(WritePortFile(path_, 5).ok());
  EXPECT_EQ(Line(path_), "5");
  std::string line;
  std::getline(old, line);
  EXPECT_EQ(line, "1234") << "written over";
  EXPECT_EQ(Files(), 1);
}

TEST_F(PortFileTest, LinksStay) {
  std::ofstream(folder_ / "file") << "old";
  fs::create_symlink("file", path_);
  ASSERT_TRUE(WritePortFile(path_, 1234).ok());
  EXPECT_TRUE(fs::is_symlink(path_));
  EXPECT_EQ(Line(folder_ / "file"), "1234");
  EXPECT_EQ(Files(), 2);
}

TEST_F(PortFileTest, PipesAndDevicesAreWrittenTo) {
  ASSERT_EQ(mkfifo(path_.c_str(), 0600), 0);
  // A reader that is there already, so that nobody waits.
  const int reader = open(path_.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC);
  EXPECT_TRUE(WritePortFile(path_, 1234).ok());
  char read_bytes[8] = {};
  EXPECT_EQ(read(reader, read_bytes, sizeof(read_bytes)), 5);
  EXPECT_STREQ(read_bytes, "1234\n");
  close(reader);
  EXPECT_TRUE(fs::is_fifo(path_));

  // By a link in our own folder: what went wrong would replace that, not the machine's device.
  const fs::path link = folder_ / "link";
  fs::create_symlink("/dev/full", link);
  EXPECT_EQ(WritePortFile(link, 1234).message(),
            "--port-file: cannot write " + link.string() + ": No space left on device");
  EXPECT_TRUE(fs::is_character_file("/dev/full"));
  EXPECT_TRUE(fs::is_symlink(link));
  EXPECT_EQ(Files(), 2);
}

TEST_F(PortFileTest, AnOpenFileIsWrittenToWhereItIs) {
  std::ofstream(path_) << "before\n";
  // As the shell opens it for `>`.
  const int output = open(path_.c_str(), O_RDWR | O_CLOEXEC);
  lseek(output, 0, SEEK_END);
  ASSERT_TRUE(WritePortFile("/proc/self/fd/" + std::to_string(output), 1234).ok());
  ASSERT_TRUE(WritePortFile("/dev/fd/" + std::to_string(output), 5).ok());
  ASSERT_EQ(write(output, "after\n", 6), 6);
  char read_bytes[32] = {};
  EXPECT_EQ(pread(output, read_bytes, sizeof(read_bytes), 0), 20) << "replaced, or written over";
  EXPECT_STREQ(read_bytes, "before\n1234\n5\nafter\n");
  close(output);
  EXPECT_EQ(Files(), 1);
}

TEST_F(PortFileTest, TellsWhyAFileCannotBeWritten) {
  EXPECT_EQ(WritePortFile("/no/such/port", 1).message(),
            "--port-file: cannot write /no/such/port: No such file or directory");
  EXPECT_THAT(std::string(WritePortFile(folder_, 1).message()), testing::HasSubstr("Is a directory"));
}

}  // namespace
}  // namespace deltaray
