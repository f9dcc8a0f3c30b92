// Several servers on one directory: what one of them changes, all others see.

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/file.h>

#include <atomic>
#include <chrono>
#include <functional>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "server/store/sha256.h"
#include "tests/eventually.h"
#include "tests/unit/store/fixture.h"

namespace deltaray {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// What README.md promises, and some time for a busy machine.
constexpr std::chrono::seconds kSoon{5};

class SharedDirectoryTest : public ::testing::Test {
 protected:
  static bool Soon(const std::function<bool()>& holds) { return Eventually(holds, kSoon); }
  static bool IsGone(MeshStore& store, const std::string& mesh) {
    return store.Get(mesh).status().code() == absl::StatusCode::kNotFound;
  }
  static Config WithDelta(uint32_t delta) {
    Config config;
    config.delta = delta;
    return config;
  }

  ScratchDirectory directory_;
  std::unique_ptr<MeshStore> stores_[3] = {OpenStore(directory_.path()), OpenStore(directory_.path()),
                                           OpenStore(directory_.path())};
  MeshStore& a_ = *stores_[0];
  MeshStore& b_ = *stores_[1];
  MeshStore& c_ = *stores_[2];
};

TEST_F(SharedDirectoryTest, AnUploadCanBeQueriedThroughAllAtOnce) {
  const auto put = Put(a_, StripObj(1), "one", WithDelta(5));
  ASSERT_TRUE(put.ok()) << put.status();
  const auto by_name = AwaitTree(b_, "one");
  ASSERT_TRUE(by_name.ok()) << by_name.status();
  EXPECT_EQ(HitStrip(*by_name, 1).t, 1);
  EXPECT_EQ(by_name->id, put->info.id);
  EXPECT_EQ(b_.Get("one")->config.delta, 5u);
  const auto by_id = AwaitTree(c_, put->info.id);
  ASSERT_TRUE(by_id.ok()) << by_id.status();
  EXPECT_EQ(HitStrip(*by_id, 1).t, 1);
  // Lists are of what was noticed.
  EXPECT_TRUE(Soon([&] { return c_.List("", 10).size() == 1; }));
  EXPECT_TRUE(Soon([&] { return c_.List("", 10)[0].names == std::vector<std::string>{"one"}; }));
}

TEST_F(SharedDirectoryTest, WhatMayNotBlockKnowsOnlyWhatWasLookedFor) {
  MeshStore::Options options;
  options.follow_interval = std::chrono::hours(1);
  const auto store = OpenStore(directory_.path(), options);
  const std::string id = Put(a_, StripObj(1), "one")->info.id;
  for (const std::string& mesh : {std::string("one"), id}) {
    EXPECT_FALSE(store->IsKnown(mesh));
    EXPECT_EQ(store->Watch(mesh).status().code(), absl::StatusCode::kNotFound);
    absl::Status told;
    store->WithTree(mesh, true, [&](const absl::StatusOr<MeshStore::Answer>& tree) { told = tree.status(); });
    EXPECT_EQ(told.code(), absl::StatusCode::kNotFound) << "is not told later either";
  }
  EXPECT_EQ(*store->Resolve("one"), id);
  EXPECT_EQ(*store->ResolveKnown("one"), id);
  EXPECT_TRUE(store->Watch("one").ok());
  EXPECT_TRUE(AwaitTree(*store, "one").ok());
}

TEST_F(SharedDirectoryTest, TreesAreBuiltWhereQueriesArrive) {
  ASSERT_TRUE(Put(a_, StripObj(1), "one").ok());
  ASSERT_TRUE(Soon([&] { return b_.List("", 10).size() == 1; }));
  EXPECT_EQ(b_.Get("one")->state, MeshState::kStored);
  ASSERT_TRUE(AwaitTree(b_, "one").ok());
  EXPECT_EQ(c_.Get("one")->state, MeshState::kStored);
}

TEST_F(SharedDirectoryTest, NamesMoveForAll) {
  const std::string one = Put(a_, StripObj(1), "name")->info.id;
  const std::string two = Put(b_, StripObj(2))->info.id;
  ASSERT_EQ(c_.Get("name")->id, one);
  EXPECT_EQ(*b_.Name("name", two), one);
  EXPECT_TRUE(Soon([&] { return a_.Get("name")->id == two && c_.Get("name")->id == two; }));
  // A store that has not noticed yet still tells what the name pointed at on disk.
  EXPECT_EQ(*a_.Name("name", one), two);
  EXPECT_EQ(*b_.Name("name", two), one);
  EXPECT_EQ(*c_.Name("name", ""), two);
  EXPECT_TRUE(Soon([&] { return IsGone(a_, "name") && IsGone(b_, "name"); }));
  EXPECT_EQ(b_.Name("name", "").status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(a_.Get(two)->names, IsEmpty());
}

TEST_F(SharedDirectoryTest, WhatOneDeletesIsGoneForAllAndBatchesFinish) {
  const std::string id = Put(a_, StripObj(1), "one")->info.id;
  const auto answer = AwaitTree(b_, "one");
  ASSERT_TRUE(answer.ok());
  EXPECT_EQ(*c_.Delete(id), id);
  EXPECT_TRUE(Soon([&] { return AwaitTree(b_, id).status().code() == absl::StatusCode::kNotFound; }));
  EXPECT_TRUE(Soon([&] { return IsGone(a_, "one"); }));
  EXPECT_EQ(HitStrip(*answer, 1).t, 1);
  EXPECT_THAT(FilesIn(directory_.path()), IsEmpty());
}

TEST_F(SharedDirectoryTest, DeletingTakesNamesThatAnotherGaveAMomentAgo) {
  const std::string id = Put(a_, StripObj(1))->info.id;
  ASSERT_TRUE(b_.Get(id).ok());
  for (int i = 0; i < 10; ++i) ASSERT_TRUE(a_.Name("name" + std::to_string(i), id).ok());
  ASSERT_TRUE(b_.Delete(id).ok());
  EXPECT_THAT(FilesIn(directory_.path()), IsEmpty());
  // So the mesh, uploaded again, has no name of old.
  EXPECT_THAT(Put(c_, StripObj(1))->info.names, IsEmpty());
  EXPECT_TRUE(IsGone(c_, "name1"));
}

TEST_F(SharedDirectoryTest, ANewConfigRebuildsTheTreesThatStand) {
  const std::string id = Put(a_, StripObj(1, 64), "one")->info.id;
  ASSERT_TRUE(AwaitTree(b_, id).ok());
  ASSERT_TRUE(c_.Get(id).ok());
  ASSERT_TRUE(a_.Rebuild(id, WithDelta(7)).ok());
  EXPECT_TRUE(Soon([&] { return b_.Get(id)->config.delta == 7 && c_.Get(id)->config.delta == 7; }));
  EXPECT_TRUE(Soon([&] { return b_.Statistics(id)->build_number == 2; }));
  EXPECT_EQ(b_.Statistics(id)->statistics.config.delta, 7u);
  EXPECT_EQ(c_.Get(id)->state, MeshState::kStored);
}

TEST_F(SharedDirectoryTest, OfUploadsOfTheSameMeshOneCreatesItAndAllNamesStay) {
  std::atomic<int> created{0};
  std::vector<std::thread> threads;
  for (int i = 0; i < 6; ++i) {
    threads.emplace_back([&, i] {
      const auto put = Put(*stores_[i % 3], StripObj(1, 500), "name" + std::to_string(i));
      ASSERT_TRUE(put.ok()) << put.status();
      created += put->created;
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(created, 1);
  EXPECT_EQ(FilesIn(directory_.path()).size(), 7u);
  for (const auto& store : stores_) {
    EXPECT_TRUE(Soon([&] { return store->List("", 10).size() == 1 && store->List("", 10)[0].names.size() == 6; }));
  }
}

TEST_F(SharedDirectoryTest, AMeshThatOneDeletesWhileAnotherStillServesItCanBeUploadedThere) {
  const std::string id = Put(a_, StripObj(1), "one", WithDelta(5))->info.id;
  ASSERT_TRUE(AwaitTree(b_, id).ok());
  ASSERT_TRUE(a_.Delete(id).ok());
  // Whether or not it has noticed.
  const auto again = Put(b_, StripObj(1), "two");
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_TRUE(again->created);
  EXPECT_THAT(again->info.names, ElementsAre("two"));
  EXPECT_EQ(again->info.config.delta, Config().delta);
  EXPECT_TRUE(AwaitTree(c_, "two").ok());
}

// A server that has not noticed that a mesh was deleted must not tell so of the one that was uploaded again.
TEST_F(SharedDirectoryTest, AMeshThatIsDeletedAndUploadedAgainIsThereForAll) {
  const std::string id = Put(a_, StripObj(1))->info.id;
  for (int i = 0; i < 40; ++i) {
    ASSERT_TRUE(b_.Get(id).ok());
    ASSERT_TRUE(a_.Delete(id).ok());
    // Its build fails where it has not noticed.
    if (i % 2 == 0) AwaitTree(b_, id).IgnoreError();
    ASSERT_TRUE(Put(c_, StripObj(1)).ok());
    const auto answer = AwaitTree(b_, id);
    ASSERT_TRUE(answer.ok()) << i << ": " << answer.status();
  }
}

TEST_F(SharedDirectoryTest, ADamagedMeshIsMendedThroughAnyServer) {
  const std::string id = Put(a_, StripObj(1), "one")->info.id;
  const std::string path = directory_.path() + "/meshes/" + id + ".mesh";
  std::string content = ReadFile(path);
  content.back() ^= 1;
  WriteFile(path, content);
  EXPECT_EQ(AwaitTree(b_, id).status().code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(AwaitTree(c_, id).status().code(), absl::StatusCode::kDataLoss);
  ASSERT_TRUE(Put(b_, StripObj(1)).ok());
  EXPECT_TRUE(AwaitTree(b_, id).ok());
  EXPECT_TRUE(Soon([&] { return AwaitTree(c_, id).ok(); }));
}

TEST_F(SharedDirectoryTest, AServerThatIsStoppedWithinAChangeHoldsUpChangesOnlyForATime) {
  using Clock = std::chrono::steady_clock;
  MeshStore::Options options;
  options.change_timeout = std::chrono::seconds(2);
  const auto store = OpenStore(directory_.path(), options);
  const std::string id = Put(*store, StripObj(1), "one")->info.id;
  const int lock = open((directory_.path() + "/lock").c_str(), O_RDWR);
  ASSERT_EQ(flock(lock, LOCK_EX), 0);

  // All at once, not one after another.
  const Clock::time_point begin = Clock::now();
  std::vector<std::thread> threads;
  for (int i = 0; i < 8; ++i) {
    threads.emplace_back([&, i] {
      const std::string name = "name" + std::to_string(i);
      const absl::Status status =
          i % 2 == 0 ? store->Name(name, id).status() : Put(*store, StripObj(i + 10), name).status();
      EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable) << status;
      EXPECT_THAT(status.ToString(), HasSubstr("lock"));
    });
  }
  EXPECT_TRUE(AwaitTree(*store, "one").ok());
  for (std::thread& thread : threads) thread.join();
  EXPECT_GE(Clock::now() - begin, options.change_timeout);
  EXPECT_LT(Clock::now() - begin, 3 * options.change_timeout);

  // Those that come later do not wait as long for what did not come before.
  const Clock::time_point later = Clock::now();
  EXPECT_EQ(store->Delete(id).status().code(), absl::StatusCode::kUnavailable);
  EXPECT_LT(Clock::now() - later, options.change_timeout / 2);

  close(lock);
  EXPECT_TRUE(store->Name("two", id).ok());
  // And so it is again.
  const int again = open((directory_.path() + "/lock").c_str(), O_RDWR);
  ASSERT_EQ(flock(again, LOCK_EX), 0);
  std::thread named([&] { EXPECT_TRUE(store->Name("three", id).ok()); });
  std::this_thread::sleep_for(options.change_timeout / 4);
  close(again);
  named.join();
}

// Random changes by three servers at once: in the end all see what is on disk, and no file is without its mesh.
TEST_F(SharedDirectoryTest, AllConvergeOnWhatIsOnDisk) {
  constexpr int kMeshes = 4, kSteps = 80;
  std::vector<std::thread> threads;
  for (int server = 0; server < 3; ++server) {
    threads.emplace_back([&, server] {
      MeshStore& store = *stores_[server];
      std::mt19937 random(server);
      for (int step = 0; step < kSteps; ++step) {
        const int mesh = static_cast<int>(random() % kMeshes);
        const std::string name = "name" + std::to_string(random() % 3);
        switch (random() % 6) {
          case 0:
          case 1:
            ASSERT_TRUE(Put(store, StripObj(mesh, 20), name).ok());
            break;
          case 2:
            store.Delete(name).IgnoreError();
            break;
          case 3:
            store.Name("moving", name).IgnoreError();
            break;
          case 4:
            store.Rebuild(name, WithDelta(1 + random() % 64)).IgnoreError();
            break;
          default:
            if (const auto answer = AwaitTree(store, name); answer.ok()) {
              const float z = answer->snapshot->mesh->positions[0].z;
              EXPECT_EQ(HitStrip(*answer, static_cast<int>(z)).t, 1);
            } else {
              EXPECT_EQ(answer.status().code(), absl::StatusCode::kNotFound) << answer.status();
            }
        }
      }
    });
  }
  for (std::thread& thread : threads) thread.join();

  const auto fresh = OpenStore(directory_.path());
  const std::vector<MeshInfo> truth = fresh->List("", 100);
  std::set<std::string> files;
  for (const MeshInfo& info : truth) {
    files.insert("meshes/" + info.id + ".mesh");
    if (std::filesystem::exists(directory_.path() + "/configs/" + info.id + ".config")) {
      files.insert("configs/" + info.id + ".config");
    }
    for (const std::string& name : info.names) files.insert("names/" + Sha256::Hex(name) + ".name");
  }
  EXPECT_EQ(FilesIn(directory_.path()), files);
  const auto describe = [](const std::vector<MeshInfo>& infos) {
    std::string text;
    for (const MeshInfo& info : infos) {
      text += info.id + " " + std::to_string(info.config.delta);
      for (const std::string& name : info.names) text += " " + name;
      text += "\n";
    }
    return text;
  };
  for (const auto& store : stores_) {
    EXPECT_TRUE(Soon([&] { return describe(store->List("", 100)) == describe(truth); }));
  }
}

}  // namespace
}  // namespace deltaray
