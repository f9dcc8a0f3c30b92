// A store whose system or disk fails it.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <thread>

#include "server/store/mesh_store.h"
#include "tests/eventually.h"
#include "tests/hindered.h"
#include "tests/unit/store/fixture.h"

namespace deltaray {
namespace {

using ::testing::HasSubstr;

TEST(HinderedStoreTest, AFullDiskFailsTheUploadAndNothingElse) {
  ScratchDirectory directory;
  const auto store = OpenStore(directory.path());
  ASSERT_TRUE(Put(*store, StripObj(1), "a").ok());
  const std::set<std::string> before = FilesIn(directory.path());
  for (const size_t limit : {0, 100, 200, 400, 800, 1600}) {
    const FileSizeLimit full(limit);
    EXPECT_EQ(Put(*store, StripObj(2, 40), "b").status().code(), absl::StatusCode::kResourceExhausted) << limit;
    if (limit < 100) {
      EXPECT_EQ(store->Name("c", "a").status().code(), absl::StatusCode::kResourceExhausted);
      EXPECT_EQ(store->Rebuild("a", {}).status().code(), absl::StatusCode::kResourceExhausted);
    }
    EXPECT_EQ(FilesIn(directory.path()), before) << limit;
  }
  EXPECT_TRUE(Put(*store, StripObj(2, 40), "b").ok());
  EXPECT_TRUE(AwaitTree(*store, "a").ok());
}

TEST(HinderedStoreTest, AReadOnlyDirectoryCanBeQueried) {
  ScratchDirectory directory;
  std::filesystem::permissions(directory.path(), std::filesystem::perms::all);
  const WithoutPrivileges without;  // before anything is made, so that nobody owns it
  const std::string path = directory.path() + "/data";
  { ASSERT_TRUE(Put(*OpenStore(path), StripObj(1), "a").ok()); }
  const auto permit = [&](std::filesystem::perms perms) {
    for (const char* folder : {"/meshes", "/names", "/configs", "/tmp", ""}) {
      std::filesystem::permissions(path + folder, perms);
    }
  };
  permit(std::filesystem::perms::owner_read | std::filesystem::perms::owner_exec);
  {
    const auto store = OpenStore(path);
    ASSERT_NE(store, nullptr);
    EXPECT_TRUE(AwaitTree(*store, "a").ok());
    EXPECT_EQ(Put(*store, StripObj(2)).status().code(), absl::StatusCode::kFailedPrecondition);
    EXPECT_EQ(store->Name("b", "a").status().code(), absl::StatusCode::kFailedPrecondition);
    EXPECT_EQ(store->Rebuild("a", {}).status().code(), absl::StatusCode::kFailedPrecondition);
    EXPECT_EQ(store->Delete("a").status().code(), absl::StatusCode::kFailedPrecondition);
    EXPECT_TRUE(store->Get("a").ok());
    // It is told from the start on, and what changes later too.
    EXPECT_FALSE(store->Usage().directory_writable);
    permit(std::filesystem::perms::owner_all);
    EXPECT_TRUE(Eventually([&] { return store->Usage().directory_writable; }));
    std::filesystem::rename(path, path + ".gone");
    EXPECT_TRUE(Eventually([&] { return !store->Usage().directory_writable; }));
    std::filesystem::rename(path + ".gone", path);
    permit(std::filesystem::perms::owner_read | std::filesystem::perms::owner_exec);
  }
  MeshStore::Options options;
  options.data_directory = path + "/sub";
  EXPECT_EQ(MeshStore::Open(options).status().code(), absl::StatusCode::kFailedPrecondition);
  options.data_directory = "";
  EXPECT_EQ(MeshStore::Open(options).status().code(), absl::StatusCode::kInvalidArgument);
  permit(std::filesystem::perms::owner_all);
}

TEST(HinderedStoreTest, ALockThatMayNotBeTakenIsToldAsADirectoryThatIsNotWritable) {
  ScratchDirectory directory;
  std::filesystem::permissions(directory.path(), std::filesystem::perms::all);
  const WithoutPrivileges without;
  const std::string path = directory.path() + "/data", lock = path + "/lock";
  const auto store = OpenStore(path);
  // Made before the first change, so that it is the server's.
  ASSERT_TRUE(std::filesystem::exists(lock));
  EXPECT_TRUE(store->Usage().directory_writable);
  std::filesystem::permissions(lock, std::filesystem::perms::owner_read);
  EXPECT_TRUE(Eventually([&] { return !store->Usage().directory_writable; }));
  EXPECT_EQ(Put(*store, StripObj(1)).status().code(), absl::StatusCode::kFailedPrecondition);
  std::filesystem::remove(lock);
  EXPECT_TRUE(Eventually([&] { return store->Usage().directory_writable; }));
  std::filesystem::permissions(path, std::filesystem::perms::owner_read | std::filesystem::perms::owner_exec);
  EXPECT_TRUE(Eventually([&] { return !store->Usage().directory_writable; }));
  std::filesystem::permissions(path, std::filesystem::perms::owner_all);
}

// Waits until a tree can be had again: a failed build is not tried at once.
void ExpectRecovers(MeshStore& store, const std::string& mesh) {
  for (int i = 0; i < 500 && !AwaitTree(store, mesh).ok(); ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  const auto answer = AwaitTree(store, mesh);
  ASSERT_TRUE(answer.ok()) << answer.status();
  EXPECT_EQ(HitStrip(*answer, 1).t, 1);
}

TEST(HinderedStoreTest, AFileThatMayNotBeReadForATimeFailsItsQueriesForThatTime) {
  ScratchDirectory directory;
  std::filesystem::permissions(directory.path(), std::filesystem::perms::all);
  const WithoutPrivileges without;
  const std::string path = directory.path() + "/data";
  const std::string id = Put(*OpenStore(path), StripObj(1), "a")->info.id;
  const auto store = OpenStore(path);
  const std::string file = path + "/meshes/" + id + ".mesh";
  std::filesystem::permissions(file, std::filesystem::perms::none);
  const absl::Status status = AwaitTree(*store, "a").status();
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(status.ToString(), HasSubstr(file));
  EXPECT_EQ(store->Watch("a", /*start=*/false)->state, MeshState::kFailed);
  EXPECT_EQ(store->Get("a").status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_TRUE(AwaitTree(*store, Put(*store, StripObj(2))->info.id).ok());
  std::filesystem::permissions(file, std::filesystem::perms::owner_all);
  ExpectRecovers(*store, "a");
}

TEST(HinderedStoreTest, AFolderThatMayNotBeReadForATimeHidesNothing) {
  ScratchDirectory directory;
  std::filesystem::permissions(directory.path(), std::filesystem::perms::all);
  const WithoutPrivileges without;
  const std::string path = directory.path() + "/data";
  const auto store = OpenStore(path);
  ASSERT_TRUE(Put(*store, StripObj(1), "a").ok());
  ASSERT_TRUE(AwaitTree(*store, "a").ok());
  for (const char* folder : {"/meshes", "/names"}) {
    std::filesystem::permissions(path + folder, std::filesystem::perms::none);
    std::this_thread::sleep_for(std::chrono::milliseconds(400));
    EXPECT_TRUE(AwaitTree(*store, "a").ok()) << folder;
    EXPECT_EQ(store->Get("b").status().code(),
              folder == std::string("/names") ? absl::StatusCode::kFailedPrecondition : absl::StatusCode::kNotFound);
    EXPECT_EQ(Put(*store, StripObj(2), "b").status().code(), absl::StatusCode::kFailedPrecondition);
    EXPECT_EQ(store->Delete("a").status().code(), absl::StatusCode::kFailedPrecondition);
    std::filesystem::permissions(path + folder, std::filesystem::perms::owner_all);
  }
  EXPECT_TRUE(Put(*store, StripObj(2), "b").ok());
  EXPECT_TRUE(store->Delete("a").ok());
}

TEST(HinderedStoreTest, WithoutFileDescriptorsItAnswersFromMemoryAndRecovers) {
#ifdef __SANITIZE_ADDRESS__
  GTEST_SKIP() << "UndefinedBehaviorSanitizer takes two file descriptors to look at an object";
#endif
  ScratchDirectory directory;
  std::string id;
  { id = Put(*OpenStore(directory.path()), StripObj(1), "a")->info.id; }
  const auto store = OpenStore(directory.path());
  const std::string known = Put(*store, StripObj(2))->info.id;
  ASSERT_TRUE(AwaitTree(*store, known).ok());
  {
    const NoFileDescriptors none;
    EXPECT_TRUE(AwaitTree(*store, known).ok());
    EXPECT_EQ(AwaitTree(*store, "a").status().code(), absl::StatusCode::kResourceExhausted);
    EXPECT_EQ(store->Get("unknown").status().code(), absl::StatusCode::kResourceExhausted);
    EXPECT_EQ(store->StartUpload().status().code(), absl::StatusCode::kResourceExhausted);
    EXPECT_EQ(store->Name("b", "a").status().code(), absl::StatusCode::kResourceExhausted);
    std::this_thread::sleep_for(std::chrono::milliseconds(400));
    EXPECT_EQ(store->List("", 10).size(), 2u);
  }
  ExpectRecovers(*store, "a");
  EXPECT_TRUE(store->Name("b", "a").ok());
}

}  // namespace
}  // namespace deltaray
