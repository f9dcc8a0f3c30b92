#include "server/store/followed_directory.h"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <thread>
#include <utility>

#include "tests/eventually.h"
#include "tests/unit/store/fixture.h"
#include "tests/unit/store/watched_disk.h"

namespace deltaray {
namespace {

TEST(FollowedDirectoryTest, ADiskThatHangsIsNotToldAsWritable) {
  using std::chrono::milliseconds;
  ScratchDirectory scratch;
  DataDirectory::Changes contents;
  absl::StatusOr<DataDirectory> files = DataDirectory::Open(scratch.path(), milliseconds(0), &contents);
  ASSERT_TRUE(files.ok()) << files.status();
  std::atomic<bool> hangs{false};
  const WatchedDisk disk([&](const DiskCall& call) {
    while (hangs && call.kind == DiskCall::kAccess) std::this_thread::sleep_for(milliseconds(1));
    return 0;
  });
  const FollowedDirectory directory(
      *std::move(files), std::move(contents), milliseconds(20), [](MeshInfo) { return nullptr; }, milliseconds(500));
  EXPECT_TRUE(Eventually([&] { return directory.is_writable(); }));
  hangs = true;
  EXPECT_TRUE(Eventually([&] { return !directory.is_writable(); }));
  hangs = false;
  EXPECT_TRUE(Eventually([&] { return directory.is_writable(); }));
}

}  // namespace
}  // namespace deltaray
