// What is acknowledged was made durable before, in the right order; and what is left where a step of that fails.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <filesystem>
#include <set>
#include <string>
#include <vector>

#include "server/store/durable_file.h"
#include "server/store/sha256.h"
#include "tests/unit/store/fixture.h"
#include "tests/unit/store/watched_disk.h"

namespace deltaray {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

Config ConfigOfDelta(uint32_t delta) {
  Config config;
  config.delta = delta;
  return config;
}

std::string FolderAbove(const std::string& path) { return std::filesystem::path(path).parent_path().string(); }

class DurabilityTest : public ::testing::Test {
 protected:
  // Nothing is noticed later: what a failure leaves in memory is there at once.
  std::unique_ptr<MeshStore> Open() {
    MeshStore::Options options;
    options.follow_interval = std::chrono::hours(1);
    return OpenStore(path_, options);
  }

  // The places that `calls` changed, relative to the directory. Each file was synced, whole, before it was moved there,
  // and each folder after it was changed.
  std::vector<std::string> Changed(const std::vector<DiskCall>& calls) const {
    std::vector<std::string> changed;
    for (auto call = calls.begin(); call != calls.end(); ++call) {
      if (call->kind == DiskCall::kSync || call->kind == DiskCall::kAccess) continue;
      const std::string& place = call->kind == DiskCall::kRename ? call->to : call->path;
      if (FolderAbove(place) == path_ + "/tmp") continue;
      EXPECT_TRUE(IsSynced(call, calls.end(), FolderAbove(place), {})) << place << " was not synced";
      if (call->kind == DiskCall::kRename) {
        EXPECT_TRUE(IsSynced(calls.begin(), call, call->path, call->size))
            << place << " was moved before it was synced";
      }
      changed.push_back(std::filesystem::relative(place, path_).string());
    }
    return changed;
  }

  // All that `store` lists.
  static std::string Describe(const MeshStore& store) {
    std::string text;
    for (const MeshInfo& info : store.List("", 100)) {
      text += info.id + " " + std::to_string(info.config.delta);
      for (const std::string& name : info.names) text += " " + name;
      text += "\n";
    }
    return text;
  }
  void ExpectMemoryAndDiskAgree() { EXPECT_EQ(Describe(*store_), Describe(*Open())); }
  std::function<int(const DiskCall&)> FailSyncs(const std::string& folder) const {
    return FailSyncsOf(path_ + "/" + folder);
  }

  static std::string NameFile(const std::string& name) { return "names/" + Sha256::Hex(name) + ".name"; }

  ScratchDirectory directory_;
  const std::string path_ = std::filesystem::canonical(directory_.path()).string();
  std::unique_ptr<MeshStore> store_ = Open();

 private:
  using Iterator = std::vector<DiskCall>::const_iterator;
  static bool IsSynced(Iterator begin, Iterator end, const std::string& path, std::optional<int64_t> size) {
    return std::any_of(begin, end, [&](const DiskCall& call) {
      return call.kind == DiskCall::kSync && call.path == path && (!size || call.size == *size);
    });
  }
};

TEST_F(DurabilityTest, WhatIsAcknowledgedWasSynced) {
  WatchedDisk disk;
  const auto put = Put(*store_, StripObj(1, 40), "one", ConfigOfDelta(5));
  ASSERT_TRUE(put.ok()) << put.status();
  const std::string& id = put->info.id;
  const std::string mesh = "meshes/" + id + ".mesh", config = "configs/" + id + ".config";
  EXPECT_THAT(Changed(disk.TakeCalls()), ElementsAre(mesh, config, NameFile("one")));

  ASSERT_TRUE(store_->Name("two", id).ok());
  EXPECT_THAT(Changed(disk.TakeCalls()), ElementsAre(NameFile("two")));
  ASSERT_TRUE(store_->Name("two", "").ok());
  EXPECT_THAT(Changed(disk.TakeCalls()), ElementsAre(NameFile("two")));
  ASSERT_TRUE(store_->Rebuild(id, ConfigOfDelta(6)).ok());
  EXPECT_THAT(Changed(disk.TakeCalls()), ElementsAre(config));
  ASSERT_TRUE(Put(*store_, StripObj(1, 40), "", ConfigOfDelta(7)).ok());
  EXPECT_THAT(Changed(disk.TakeCalls()), ElementsAre(config));
  ASSERT_TRUE(store_->Delete(id).ok());
  EXPECT_THAT(Changed(disk.TakeCalls()), ElementsAre(NameFile("one"), config, mesh));
}

TEST_F(DurabilityTest, ANewDirectoryIsSynced) {
  WatchedDisk disk;
  ASSERT_TRUE(MakeFolder(path_ + "/new/data").ok());
  EXPECT_THAT(Changed(disk.TakeCalls()), ElementsAre("new", "new/data"));
}

// A server may have died, or failed, after it moved files and before it synced their folders.
TEST_F(DurabilityTest, WhatIsFoundOnDiskIsSyncedBeforeItIsAcknowledged) {
  std::string id;
  {
    WatchedDisk disk([this, failing = FailSyncs("meshes")](const DiskCall& call) {
      return call.kind == DiskCall::kUnlink && FolderAbove(call.path) == path_ + "/meshes" ? EIO : failing(call);
    });
    EXPECT_EQ(Put(*store_, StripObj(1)).status().code(), absl::StatusCode::kInternal);
    ExpectMemoryAndDiskAgree();
    ASSERT_EQ(store_->List("", 2).size(), 1u);
  }
  {
    WatchedDisk disk;
    id = Put(*store_, StripObj(1))->info.id;
    const std::vector<DiskCall> calls = disk.TakeCalls();
    EXPECT_THAT(Changed(calls), IsEmpty());
    EXPECT_TRUE(std::any_of(calls.begin(), calls.end(), [&](const DiskCall& call) {
      return call.kind == DiskCall::kSync && call.path == path_ + "/meshes";
    }));
  }
  {
    WatchedDisk disk(FailSyncs("names"));
    EXPECT_EQ(store_->Name("one", id).status().code(), absl::StatusCode::kInternal);
    EXPECT_EQ(store_->Name("one", id).status().code(), absl::StatusCode::kInternal);
  }
  EXPECT_EQ(*store_->Name("one", id), id);
}

TEST_F(DurabilityTest, WhatIsFoundRemovedIsSyncedBeforeItIsAcknowledged) {
  const auto is_synced = [&](WatchedDisk& disk, const std::string& folder) {
    const std::vector<DiskCall> calls = disk.TakeCalls();
    return std::any_of(calls.begin(), calls.end(), [&](const DiskCall& call) {
      return call.kind == DiskCall::kSync && call.path == path_ + "/" + folder;
    });
  };
  const auto remove_name = [&](const std::string&) { return store_->Name("a", "").status(); };
  const auto remove_mesh = [&](const std::string& id) { return store_->Delete(id).status(); };
  const auto expect_synced = [&](const std::string& folder, const auto& remove) {
    const std::string id = Put(*store_, StripObj(1), "a", ConfigOfDelta(5))->info.id;
    {
      WatchedDisk disk(FailSyncs(folder));
      EXPECT_EQ(remove(id).code(), absl::StatusCode::kInternal);
      EXPECT_EQ(remove(id).code(), absl::StatusCode::kInternal) << "not synced: " << folder;
    }
    WatchedDisk disk;
    const absl::Status status = remove(id);
    EXPECT_TRUE(status.ok() || absl::IsNotFound(status)) << status;
    EXPECT_TRUE(is_synced(disk, folder)) << folder;
  };
  expect_synced("names", remove_name);
  for (const char* folder : {"names", "configs", "meshes"}) expect_synced(folder, remove_mesh);
}

TEST_F(DurabilityTest, AFailedUploadLeavesNoNameWithoutItsMesh) {
  const std::string old = Put(*store_, StripObj(1), "prod")->info.id;
  {
    WatchedDisk disk(FailSyncs("names"));
    EXPECT_EQ(Put(*store_, StripObj(2), "prod").status().code(), absl::StatusCode::kInternal);
    EXPECT_EQ(Put(*store_, StripObj(3), "new").status().code(), absl::StatusCode::kInternal);
  }
  const auto answer = AwaitTree(*store_, "prod");
  ASSERT_TRUE(answer.ok()) << answer.status();
  EXPECT_EQ(HitStrip(*answer, answer->id == old ? 1 : 2).t, 1);
  ExpectMemoryAndDiskAgree();
  EXPECT_TRUE(Open()->Get("prod").ok());

  const auto again = Put(*store_, StripObj(2), "prod");
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_EQ(store_->Get("prod")->id, again->info.id);
}

TEST_F(DurabilityTest, AnUploadThatFailsBeforeItsNameIsMovedIsUndone) {
  const std::string old = Put(*store_, StripObj(1), "prod", ConfigOfDelta(5))->info.id;
  const std::set<std::string> before = FilesIn(path_);
  {
    WatchedDisk disk(FailSyncs("meshes"));
    EXPECT_EQ(Put(*store_, StripObj(2), "prod").status().code(), absl::StatusCode::kInternal);
  }
  EXPECT_EQ(FilesIn(path_), before);
  EXPECT_EQ(store_->Get("prod")->id, old);
  ExpectMemoryAndDiskAgree();
  // Of a mesh that was there before, the mesh stays, with one of the two configs.
  WatchedDisk disk(FailSyncs("configs"));
  EXPECT_EQ(Put(*store_, StripObj(1), "new", ConfigOfDelta(6)).status().code(), absl::StatusCode::kInternal);
  EXPECT_EQ(FilesIn(path_), before);
  ExpectMemoryAndDiskAgree();
}

TEST_F(DurabilityTest, AfterAFailedChangeMemoryAndDiskAgree) {
  const std::string one = Put(*store_, StripObj(1), "a", ConfigOfDelta(5))->info.id;
  const std::string two = Put(*store_, StripObj(2), "b", ConfigOfDelta(5))->info.id;
  const auto expect_fails = [&](const std::string& folder, const std::function<absl::Status()>& change) {
    WatchedDisk disk(FailSyncs(folder));
    EXPECT_EQ(change().code(), absl::StatusCode::kInternal) << folder;
    ExpectMemoryAndDiskAgree();
  };
  expect_fails("names", [&] { return store_->Name("a", two).status(); });
  expect_fails("names", [&] { return store_->Name("a", "").status(); });
  expect_fails("configs", [&] { return store_->Rebuild(one, ConfigOfDelta(6)).status(); });
  for (const char* folder : {"names", "configs", "meshes"}) {
    const std::string id = Put(*store_, StripObj(3), "c", ConfigOfDelta(5))->info.id;
    expect_fails(folder, [&] { return store_->Delete(id).status(); });
  }
}

}  // namespace
}  // namespace deltaray
