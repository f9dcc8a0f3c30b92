#include "server/store/data_directory.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <set>
#include <string>
#include <thread>

#include "server/store/sha256.h"
#include "tests/unit/store/fixture.h"

namespace deltaray {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// A directory with two meshes, "good" and "bad", of which the files of the latter will be damaged.
class DataDirectoryTest : public ::testing::Test {
 protected:
  DataDirectoryTest() {
    const auto store = OpenStore(path_);
    Config config;
    config.delta = 7;
    good_ = Put(*store, StripObj(1), "good", config)->info.id;
    bad_ = Put(*store, StripObj(2), "bad", config)->info.id;
  }

  std::string MeshFile(const std::string& id) const { return path_ + "/meshes/" + id + ".mesh"; }
  std::string ConfigFile(const std::string& id) const { return path_ + "/configs/" + id + ".config"; }
  std::string NameFile(const std::string& name) const { return path_ + "/names/" + Sha256::Hex(name) + ".name"; }

  static void ExpectGood(MeshStore& store) {
    const auto answer = AwaitTree(store, "good");
    ASSERT_TRUE(answer.ok()) << answer.status();
    EXPECT_EQ(HitStrip(*answer, 1).t, 1);
    EXPECT_EQ(store.Get("good")->config.delta, 7u);
  }

  ScratchDirectory directory_;
  const std::string path_ = directory_.path();
  std::string good_, bad_;
};

TEST_F(DataDirectoryTest, AMeshWithADamagedHeadIsLeftOutAndItsFilesStay) {
  std::string content = ReadFile(MeshFile(bad_));
  content[100] ^= 1;
  WriteFile(MeshFile(bad_), content);
  const std::set<std::string> files = FilesIn(path_);
  {
    const auto store = OpenStore(path_);
    ExpectGood(*store);
    EXPECT_EQ(store->List("", 10).size(), 1u);
    for (const std::string& mesh : {std::string("bad"), bad_}) {
      EXPECT_EQ(store->Get(mesh).status().code(), absl::StatusCode::kDataLoss);
      EXPECT_THAT(store->Get(mesh).status().ToString(), HasSubstr(MeshFile(bad_)));
      EXPECT_EQ(AwaitTree(*store, mesh).status().code(), absl::StatusCode::kDataLoss);
    }
  }
  EXPECT_EQ(FilesIn(path_), files);
  // Once the file is mended, name and config are there again.
  content[100] ^= 1;
  WriteFile(MeshFile(bad_), content);
  const auto store = OpenStore(path_);
  EXPECT_EQ(store->Get("bad")->config.delta, 7u);
}

TEST_F(DataDirectoryTest, AConfigThatCanNotBeReadForNowIsTheOneBefore) {
  const auto store = OpenStore(path_);
  ASSERT_TRUE(AwaitTree(*store, "bad").ok());
  // Each change is one rename: the store, which looks all the time, must not find the file missing.
  const ScratchDirectory beside;
  const std::string kept = beside.path() + "/kept.config", link = beside.path() + "/link.config";
  std::filesystem::copy_file(ConfigFile(bad_), kept);
  std::filesystem::create_symlink(ConfigFile(bad_), link);
  std::filesystem::rename(link, ConfigFile(bad_));  // leads to itself
  ASSERT_TRUE(store->Name("another", bad_).ok());
  EXPECT_EQ(store->Get("bad")->config.delta, 7u);
  std::this_thread::sleep_for(std::chrono::milliseconds(600));
  EXPECT_EQ(store->Get("bad")->config.delta, 7u);
  std::filesystem::rename(kept, ConfigFile(bad_));
  ASSERT_TRUE(store->Name("a third", bad_).ok());
  EXPECT_EQ(store->Get("bad")->config.delta, 7u);
  EXPECT_EQ(store->Watch("bad")->build_number, 1u);
}

TEST_F(DataDirectoryTest, DamagedGeometryIsNeverServed) {
  std::string content = ReadFile(MeshFile(bad_));
  content.back() ^= 1;
  WriteFile(MeshFile(bad_), content);
  const auto store = OpenStore(path_);
  for (int i = 0; i < 2; ++i) {
    const auto answer = AwaitTree(*store, "bad");
    EXPECT_EQ(answer.status().code(), absl::StatusCode::kDataLoss);
    EXPECT_THAT(answer.status().ToString(), HasSubstr(MeshFile(bad_)));
  }
  EXPECT_EQ(store->Get("bad")->state, MeshState::kFailed);
  EXPECT_THAT(store->Get("bad")->failure, HasSubstr("checksum"));
  EXPECT_EQ(store->Watch("bad")->state, MeshState::kFailed);
  ExpectGood(*store);

  // Uploading the mesh again mends it.
  const auto again = Put(*store, StripObj(2));
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_FALSE(again->created);
  EXPECT_THAT(again->info.names, ElementsAre("bad"));
  EXPECT_EQ(again->info.config.delta, 7u);
  EXPECT_TRUE(AwaitTree(*store, "bad").ok());
  EXPECT_TRUE(AwaitTree(*OpenStore(path_), "bad").ok());
}

// A reply to an upload says that the mesh is on disk, whatever was known of it.
TEST_F(DataDirectoryTest, AnUploadMendsDamageThatNobodyHasMet) {
  const auto store = OpenStore(path_);
  ASSERT_TRUE(AwaitTree(*store, "bad").ok());
  const std::string whole = ReadFile(MeshFile(bad_));
  std::string changed = whole;
  changed.back() ^= 1;
  for (const std::string& damaged : {changed, whole.substr(0, 100), std::string()}) {
    WriteFile(MeshFile(bad_), damaged);
    const auto again = Put(*store, StripObj(2));
    ASSERT_TRUE(again.ok()) << again.status();
    EXPECT_THAT(again->info.names, ElementsAre("bad"));
    EXPECT_EQ(again->info.config.delta, 7u);
    EXPECT_TRUE(AwaitTree(*store, "bad").ok());
    EXPECT_TRUE(AwaitTree(*OpenStore(path_), "bad").ok());
  }
  // A whole file stays as it is.
  const auto time = std::filesystem::last_write_time(MeshFile(bad_));
  ASSERT_TRUE(Put(*store, StripObj(2)).ok());
  EXPECT_EQ(std::filesystem::last_write_time(MeshFile(bad_)), time);
}

TEST_F(DataDirectoryTest, ADirectoryThatIsGoneIsNoMissingMesh) {
  const auto store = OpenStore(path_);
  ASSERT_TRUE(AwaitTree(*store, "good").ok());
  std::filesystem::rename(path_, path_ + ".gone");
  const auto expect_gone = [&](const absl::Status& status) {
    EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition) << status;
    EXPECT_THAT(std::string(status.message()), HasSubstr("data directory is gone: no " + path_));
  };
  expect_gone(store->Name("another", "good").status());
  expect_gone(store->Name("good", "").status());
  expect_gone(store->Rebuild("good", Config()).status());
  expect_gone(store->Delete("good").status());
  expect_gone(Put(*store, StripObj(1)).status());
  expect_gone(store->Get("good").status());
  expect_gone(store->Get("unknown").status());
  // It has no tree yet, and was not deleted; nor is its file lost.
  const absl::Status unbuilt = AwaitTree(*store, "bad").status();
  EXPECT_EQ(unbuilt.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(unbuilt.message()), HasSubstr("data directory is gone: no " + path_ + "/meshes"));
  EXPECT_EQ(store->Watch("bad", /*start=*/false)->build_number, 2u) << "was tried again";
  EXPECT_TRUE(AwaitTree(*store, "good").ok());
  std::filesystem::rename(path_ + ".gone", path_);
  EXPECT_EQ(store->Get("good")->state, MeshState::kReady);
  EXPECT_TRUE(store->Name("another", "good").ok());
}

TEST_F(DataDirectoryTest, WhileAFolderIsGoneNothingChanges) {
  for (const char* folder : {"meshes", "configs", "names", "tmp"}) {
    const std::string away = path_ + "/" + folder + ".away";
    const auto store = OpenStore(path_);
    ASSERT_TRUE(AwaitTree(*store, "good").ok());
    std::filesystem::rename(path_ + "/" + folder, away);
    const std::set<std::string> files = FilesIn(path_);
    const auto expect_gone = [&](const absl::Status& status) {
      EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition) << folder << ": " << status;
      EXPECT_THAT(std::string(status.message()), HasSubstr("data directory is gone: no " + path_ + "/" + folder));
    };
    expect_gone(store->Name("another", "good").status());
    expect_gone(store->Name("good", "").status());
    expect_gone(store->Rebuild("good", Config()).status());
    expect_gone(store->Delete("good").status());
    expect_gone(store->Delete(std::string(64, '0')).status());
    expect_gone(Put(*store, StripObj(1), "good", Config()).status());
    expect_gone(Put(*store, StripObj(3)).status());
    std::this_thread::sleep_for(std::chrono::milliseconds(400));  // the follower looks too
    EXPECT_EQ(FilesIn(path_), files);
    EXPECT_EQ(store->Watch("good")->build_number, 1u) << folder;
    std::filesystem::rename(away, path_ + "/" + folder);
    ASSERT_TRUE(store->Name("another", "good").ok());
    EXPECT_EQ(store->Watch("good")->build_number, 1u) << folder;
  }
}

TEST_F(DataDirectoryTest, AConfigWhoseFolderIsGoneIsTheOneBefore) {
  const auto store = OpenStore(path_);
  ASSERT_TRUE(AwaitTree(*store, "bad").ok());
  std::filesystem::rename(path_ + "/configs", path_ + "/away");
  // Read anew, since its file has changed.
  const std::string content = ReadFile(MeshFile(bad_));
  WriteFile(path_ + "/tmp/mesh", content);
  std::filesystem::rename(path_ + "/tmp/mesh", MeshFile(bad_));
  std::this_thread::sleep_for(std::chrono::milliseconds(600));
  std::filesystem::rename(path_ + "/away", path_ + "/configs");
  ASSERT_TRUE(store->Name("another", "bad").ok());
  EXPECT_EQ(store->Watch("bad")->build_number, 1u);
  ExpectGood(*store);
}

TEST_F(DataDirectoryTest, AMeshFileThatVanishesIsADeletedMesh) {
  const auto store = OpenStore(path_);
  std::filesystem::remove(MeshFile(bad_));
  EXPECT_EQ(AwaitTree(*store, "bad").status().code(), absl::StatusCode::kNotFound);
  ExpectGood(*store);
  EXPECT_EQ(store->Delete("bad").status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(store->List("", 10).size(), 1u);
}

TEST_F(DataDirectoryTest, AMeshWhoseFileIsLostWhileItIsKnownIsNoLongerTold) {
  MeshStore::Options options;
  options.follow_interval = std::chrono::hours(1);  // so that nobody notices but who asks
  const auto store = OpenStore(path_, options);
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  const std::string content = ReadFile(MeshFile(bad_));
  ASSERT_TRUE(store->Get("bad").ok());
  WriteFile(MeshFile(bad_), content.substr(0, 100));
  const absl::Status damaged = store->Get("bad").status();
  EXPECT_EQ(damaged.code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(damaged.ToString(), HasSubstr(MeshFile(bad_)));
  std::filesystem::remove(MeshFile(bad_));
  const absl::Status gone = store->Get("bad").status();
  EXPECT_EQ(gone.code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(gone.ToString(), HasSubstr("no mesh is named bad"));
  WriteFile(MeshFile(bad_), content);
  EXPECT_EQ(store->Get("bad")->id, bad_);
}

TEST_F(DataDirectoryTest, ADamagedMeshCanBeDeleted) {
  WriteFile(MeshFile(bad_), "no mesh");
  const auto store = OpenStore(path_);
  ASSERT_EQ(store->Get(bad_).status().code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(*store->Delete(bad_), bad_);
  EXPECT_EQ(store->Get(bad_).status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(store->Get("bad").status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(FilesIn(path_).size(), 3u);
}

TEST_F(DataDirectoryTest, WhereverTheMeshFileIsCutItIsNotServed) {
  const std::string content = ReadFile(MeshFile(bad_));
  for (size_t size = 0; size < content.size(); size += 17) {
    WriteFile(MeshFile(bad_), content.substr(0, size));
    DataDirectory::Changes contents;
    ASSERT_TRUE(DataDirectory::Open(path_, std::chrono::seconds(10), &contents).ok());
    ASSERT_EQ(contents.meshes.size(), 1u) << size;
    EXPECT_EQ(contents.meshes[0].id, good_);
  }
}

TEST_F(DataDirectoryTest, WhereverARecordIsDamagedOnlyItIsLost) {
  const std::string name = ReadFile(NameFile("bad"));
  for (size_t i = 0; i < name.size(); i += 7) {
    std::string flipped = name;
    flipped[i] ^= 4;
    WriteFile(NameFile("bad"), flipped);
    DataDirectory::Changes contents;
    ASSERT_TRUE(DataDirectory::Open(path_, std::chrono::seconds(10), &contents).ok());
    EXPECT_EQ(contents.meshes.size(), 2u);
    ASSERT_EQ(contents.names.size(), 1u) << i;
  }
  const std::string config = ReadFile(ConfigFile(bad_));
  for (size_t i = 0; i < config.size(); i += 7) {
    WriteFile(ConfigFile(bad_), config.substr(0, i));
    DataDirectory::Changes contents;
    ASSERT_TRUE(DataDirectory::Open(path_, std::chrono::seconds(10), &contents).ok());
    ASSERT_EQ(contents.meshes.size(), 2u);
    EXPECT_EQ(contents.meshes[contents.meshes[0].id == bad_ ? 0 : 1].config.delta, Config().delta) << i;
  }
}

TEST_F(DataDirectoryTest, NamesAndConfigsWithoutAMeshAreDropped) {
  std::filesystem::remove(MeshFile(bad_));
  const auto store = OpenStore(path_);
  ExpectGood(*store);
  EXPECT_FALSE(std::filesystem::exists(NameFile("bad")));
  EXPECT_FALSE(std::filesystem::exists(ConfigFile(bad_)));
  EXPECT_EQ(FilesIn(path_).size(), 3u);
}

TEST_F(DataDirectoryTest, AFileUnderAnothersNameIsNotTaken) {
  const std::string other(64, '0');
  std::filesystem::copy(MeshFile(good_), MeshFile(other));
  std::filesystem::copy(NameFile("good"), NameFile("better"));
  const auto store = OpenStore(path_);
  ExpectGood(*store);
  EXPECT_EQ(store->Get(other).status().code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(store->Get("better").status().code(), absl::StatusCode::kDataLoss);
}

TEST_F(DataDirectoryTest, ForeignFilesAreLeftAlone) {
  WriteFile(path_ + "/meshes/README", "hands off");
  WriteFile(path_ + "/names/x.name", "hands off");
  WriteFile(path_ + "/lost+found", "hands off");
  std::filesystem::create_directory(MeshFile(std::string(64, 'a')));
  const auto store = OpenStore(path_);
  ExpectGood(*store);
  EXPECT_EQ(ReadFile(path_ + "/meshes/README"), "hands off");
  EXPECT_EQ(ReadFile(path_ + "/names/x.name"), "hands off");
}

TEST_F(DataDirectoryTest, WhatADeadServerLeftHalfDoneIsRemoved) {
  WriteFile(path_ + "/tmp/0123456789abcdef", "half a mesh");
  const auto store = OpenStore(path_);
  EXPECT_THAT(FilesIn(path_ + "/tmp"), IsEmpty());
}

}  // namespace
}  // namespace deltaray
