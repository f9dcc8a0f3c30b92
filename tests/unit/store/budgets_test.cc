// The limits of a store, and what it does at each of them.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <malloc.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <future>
#include <string>
#include <thread>

#include "absl/strings/str_cat.h"
#include "server/build/memory_estimate.h"
#include "tests/eventually.h"
#include "tests/gate.h"
#include "tests/unit/store/fixture.h"

namespace deltaray {
namespace {

using ::testing::HasSubstr;

void ExpectOver(const absl::Status& status, const std::string& limit) {
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted) << status;
  EXPECT_THAT(status.ToString(), HasSubstr(limit));
}

TEST(BudgetsTest, MeshesAndNamesAreLimited) {
  ScratchDirectory directory;
  MeshStore::Options options;
  options.max_meshes = 2;
  options.max_names = 3;
  options.max_names_per_mesh = 2;
  const auto store = OpenStore(directory.path(), options);
  ASSERT_TRUE(Put(*store, StripObj(1), "a").ok());
  ASSERT_TRUE(Put(*store, StripObj(2), "b").ok());
  const std::set<std::string> files = FilesIn(directory.path());
  ExpectOver(Put(*store, StripObj(3), "a").status(), "limit of 2 meshes is met (--max-meshes)");
  EXPECT_EQ(FilesIn(directory.path()), files);
  EXPECT_TRUE(Put(*store, StripObj(1), "a").ok());

  ASSERT_TRUE(store->Name("c", "a").ok());
  ExpectOver(store->Name("d", "a").status(), "limit of 2 names of one mesh is met (--max-names-per-mesh)");
  ExpectOver(Put(*store, StripObj(1), "d").status(), "--max-names-per-mesh");
  ExpectOver(store->Name("d", "b").status(), "limit of 3 names is met (--max-names)");
  EXPECT_TRUE(store->Name("c", "b").ok());  // moves
  EXPECT_TRUE(store->Name("c", "b").ok());
  EXPECT_TRUE(store->Name("c", "").ok());
  EXPECT_TRUE(store->Name("d", "b").ok());
  EXPECT_TRUE(store->Delete("a").ok());
  EXPECT_TRUE(Put(*store, StripObj(3), "a").ok());
}

TEST(BudgetsTest, BytesOnDiskAreLimited) {
  ScratchDirectory directory;
  MeshStore::Options options;
  options.max_stored_bytes = 20'000;
  const auto store = OpenStore(directory.path(), options);
  const auto first = Put(*store, StripObj(1, 100));
  ASSERT_TRUE(first.ok()) << first.status();
  ASSERT_GT(first->info.stored_bytes, 4'000u);
  ExpectOver(Put(*store, StripObj(2, 400)).status(), "20000 bytes on disk (--max-stored-bytes)");
  EXPECT_EQ(FilesIn(directory.path()).size(), 1u);
  EXPECT_TRUE(Put(*store, StripObj(3, 50)).ok());
  // What is there already takes no more.
  EXPECT_TRUE(Put(*store, StripObj(1, 100), "a").ok());
  EXPECT_TRUE(store->Delete("a").ok());
  EXPECT_TRUE(Put(*store, StripObj(4, 100)).ok());
}

// An OBJ file of triangles, each in a group with a name of 1,000 bytes.
std::string GroupsObj(int number, int groups) {
  std::string obj = absl::StrCat("v 0 0 ", number, "\nv 1 0 0\nv 0 1 0\n");
  for (int i = 0; i < groups; ++i) absl::StrAppend(&obj, "g ", i, std::string(994, 'x'), "\nf 1 2 3\n");
  return obj;
}

TEST(BudgetsTest, GroupNamesTakeNoMemoryThatIsNotCounted) {
  constexpr int kMeshes = 20, kGroups = 1'000;
  const auto in_use = [] {
    const struct mallinfo2 info = mallinfo2();  // all zero with sanitizers
    return static_cast<int64_t>(info.uordblks + info.hblkhd);
  };
  ScratchDirectory directory;
  for (const bool are_stored : {false, true}) {
    const int64_t before = in_use();
    const auto store = OpenStore(directory.path());
    for (int i = 0; i < kMeshes; ++i) {
      const std::string name = absl::StrCat("mesh", i);
      if (!are_stored) {
        ASSERT_TRUE(Put(*store, GroupsObj(i, kGroups), name).ok());
        ASSERT_TRUE(AwaitTree(*store, name).ok());
      }
      ASSERT_EQ(store->Get(name)->groups.size(), size_t{kGroups});
    }
    const int64_t counted = static_cast<int64_t>(store->Usage().budget_bytes);
    EXPECT_LT(in_use() - before - counted, 1'000 * kGroups * kMeshes / 4) << are_stored;
  }
}

// Of trees of 6,000 triangles, some 0.5 MB each with their meshes, one stands while another is built, which takes up
// to 4.8 MB.
class TreeBytesTest : public ::testing::Test {
 protected:
  static constexpr int kSquares = 3000;
  static uint64_t OneBuild() { return EstimateBuildBytes(Config(), 2 * kSquares); }
  static MeshStore::Options Options() {
    MeshStore::Options options;
    options.tree_bytes = OneBuild() + 1'070'000;  // room for a finished tree beside a build
    options.follow_interval = std::chrono::milliseconds(20);
    return options;
  }
  std::string Upload(int number) {
    const auto put = Put(*store_, StripObj(number, kSquares));
    EXPECT_TRUE(put.ok()) << put.status();
    EXPECT_TRUE(AwaitTree(*store_, put->info.id).ok());
    return put->info.id;
  }
  MeshState State(const std::string& id) { return store_->Get(id)->state; }

  ScratchDirectory directory_;
  std::unique_ptr<MeshStore> store_ = OpenStore(directory_.path(), Options());
};

TEST_F(TreeBytesTest, TheTreeThatWasNotUsedForLongestMakesRoomAndIsBuiltAgain) {
  std::vector<std::string> ids;
  for (int i = 0; i < 8; ++i) {
    ids.push_back(Upload(i));
    ASSERT_TRUE(AwaitTree(*store_, ids[0]).ok());
  }
  EXPECT_EQ(State(ids[0]), MeshState::kReady);  // asked for all the time
  EXPECT_EQ(State(ids[1]), MeshState::kStored);
  EXPECT_EQ(State(ids[7]), MeshState::kReady);
  EXPECT_EQ(store_->Statistics(ids[1]).status().code(), absl::StatusCode::kFailedPrecondition);
  for (int i = 0; i < 8; ++i) {
    const auto answer = AwaitTree(*store_, ids[i], i % 2 == 0);
    ASSERT_TRUE(answer.ok()) << answer.status();
    EXPECT_EQ(HitStrip(*answer, i).t, 1);
  }
}

TEST_F(TreeBytesTest, TreesInUseCountUntilTheirBatchesEnd) {
  std::vector<MeshStore::Answer> in_use;
  for (int i = 0; i < 2; ++i) in_use.push_back(*AwaitTree(*store_, Upload(i)));
  const auto put = Put(*store_, StripObj(2, kSquares));
  ASSERT_TRUE(put.ok()) << put.status();
  auto waits = FutureTree(*store_, put->info.id, true);
  EXPECT_EQ(waits.wait_for(std::chrono::milliseconds(200)), std::future_status::timeout);
  EXPECT_EQ(HitStrip(in_use[0], 0).t, 1);
  in_use.clear();
  EXPECT_TRUE(waits.get().ok());
}

TEST_F(TreeBytesTest, NoMoreTreesAreDroppedThanItTakes) {
  MeshStore::Options options = Options();
  options.tree_bytes = OneBuild() + 2'570'000;
  store_.reset();
  store_ = OpenStore(directory_.path(), options);
  std::vector<std::string> ids;
  std::vector<MeshStore::Answer> in_use;
  for (int i = 0; i < 5; ++i) {
    ids.push_back(Upload(i));
    in_use.push_back(*AwaitTree(*store_, ids.back()));
  }
  const auto put = Put(*store_, StripObj(5, kSquares));
  auto waits = FutureTree(*store_, put->info.id, true);
  EXPECT_EQ(waits.wait_for(std::chrono::milliseconds(200)), std::future_status::timeout);
  EXPECT_EQ(State(ids[0]), MeshState::kStored);
  EXPECT_EQ(std::count_if(ids.begin(), ids.end(), [&](const auto& id) { return State(id) == MeshState::kReady; }), 4);
  in_use.clear();
  EXPECT_TRUE(waits.get().ok());
}

TEST_F(TreeBytesTest, TreesAreNotDroppedForRoomThatTheyDoNotMake) {
  Gate gate;
  MeshStore::Options options = Options();
  options.tree_bytes = OneBuild() + 2'570'000;
  options.concurrent_builds = 2;
  options.on_delta_leaf = [&] { gate.Pass(); };
  store_.reset();
  store_ = OpenStore(directory_.path(), options);
  const std::string ready = Upload(1);
  gate.Close();
  const auto building = Put(*store_, StripObj(2, kSquares));
  ASSERT_TRUE(AwaitTree(*store_, building->info.id, false).ok());
  auto waits = FutureTree(*store_, Put(*store_, StripObj(3, kSquares))->info.id, true);
  EXPECT_EQ(waits.wait_for(std::chrono::milliseconds(200)), std::future_status::timeout);
  EXPECT_EQ(State(ready), MeshState::kReady);
  gate.Open();
  EXPECT_TRUE(waits.get().ok());
}

TEST_F(TreeBytesTest, ABuildThatIsCancelledWhileItWaitsTellsForHowLong) {
  std::promise<EndedBuild> ended;
  MeshStore::Options options = Options();
  options.on_build_end = [&](const EndedBuild& build) {
    if (!build.status.ok()) ended.set_value(build);
  };
  store_.reset();
  store_ = OpenStore(directory_.path(), options);
  std::vector<MeshStore::Answer> in_use;
  for (int i = 0; i < 2; ++i) in_use.push_back(*AwaitTree(*store_, Upload(i)));
  const auto put = Put(*store_, StripObj(2, kSquares));
  while (store_->Watch(put->info.id)->progress.phase == BuildPhase::kQueued) std::this_thread::yield();
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  EXPECT_TRUE(store_->Delete(put->info.id).ok());
  const EndedBuild build = ended.get_future().get();
  EXPECT_EQ(build.status.code(), absl::StatusCode::kCancelled);
  EXPECT_GE(build.seconds, 0.05);
}

TEST_F(TreeBytesTest, AMeshWhoseTreeCanNotFitSaysSoAndDisturbsNobody) {
  const std::string small = Upload(1);
  const auto put = Put(*store_, StripObj(2, 5000));
  ASSERT_TRUE(put.ok()) << put.status();
  const auto answer = AwaitTree(*store_, put->info.id);
  ExpectOver(answer.status(), absl::StrCat("more than the limit of ", Options().tree_bytes, " bytes (--tree-bytes)"));
  EXPECT_THAT(answer.status().ToString(), HasSubstr("of 10000 triangles"));
  EXPECT_EQ(State(put->info.id), MeshState::kFailed);
  EXPECT_EQ(State(small), MeshState::kReady);
  // Options that were chosen, and can never do, are refused, and leave what there is.
  const std::string over = absl::StrCat("more than the limit of ", Options().tree_bytes, " bytes (--tree-bytes)");
  ExpectOver(store_->Rebuild(small, MakeConfig(Builder::kKdTree, Preset::kBest)).status(), over);
  EXPECT_EQ(State(small), MeshState::kReady);
  EXPECT_EQ(store_->Get(small)->config.builder, Builder::kHybrid);
  ExpectOver(Put(*store_, StripObj(3, 5000), "", MakeConfig(Builder::kHybrid, Preset::kBest)).status(), over);
  EXPECT_EQ(store_->List("", 10).size(), 2u);
  // A config that takes less may do.
  Config config = MakeConfig(Builder::kHybrid, Preset::kFast);
  ASSERT_TRUE(store_->Rebuild(put->info.id, config).ok());
  EXPECT_TRUE(AwaitTree(*store_, put->info.id).ok());
}

TEST_F(TreeBytesTest, ARebuildTakesTheRoomOfTheOldTreeWhereThereIsNoOther) {
  MeshStore::Options options = Options();
  options.tree_bytes = OneBuild() + 271'000;  // not enough for a finished tree
  store_.reset();
  store_ = OpenStore(directory_.path(), options);
  const std::string id = Upload(1);
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(store_->Rebuild(id, {}).ok());
    const auto answer = AwaitTree(*store_, id);
    ASSERT_TRUE(answer.ok()) << answer.status();
    EXPECT_EQ(HitStrip(*answer, 1).t, 1);
  }
}

TEST_F(TreeBytesTest, AnUploadThatTakesTooMuchMemoryIsRefused) {
  const std::string small = Upload(1);
  ExpectOver(Put(*store_, StripObj(2, 40 * kSquares)).status(),
             absl::StrCat(Options().tree_bytes, " bytes (--tree-bytes)"));
  EXPECT_EQ(store_->List("", 10).size(), 1u);
  EXPECT_TRUE(AwaitTree(*store_, small).ok());
}

TEST_F(TreeBytesTest, ALazyTreeMakesRoomToo) {
  Config lazy;
  lazy.lazy = true;
  lazy.duplication_budget = 0.1;  // what is reserved for lazy builds is more
  const auto put = Put(*store_, StripObj(1, kSquares), "lazy", lazy);
  ASSERT_TRUE(AwaitTree(*store_, "lazy").ok());
  Upload(2);
  EXPECT_EQ(State("lazy"), MeshState::kStored);
  EXPECT_EQ(HitStrip(*AwaitTree(*store_, "lazy"), 1).t, 1);
}

TEST(BudgetsTest, ANewConfigThatFindsTheQueueFullIsBuiltOnceThereIsRoom) {
  ScratchDirectory directory;
  Gate gate;
  MeshStore::Options options;
  options.max_queued_builds = 1;
  options.follow_interval = std::chrono::milliseconds(20);
  options.on_delta_leaf = [&] { gate.Pass(); };
  const auto store = OpenStore(directory.path(), options);
  const auto other = OpenStore(directory.path());
  const auto with_delta = [](uint32_t delta) {
    Config config;
    config.delta = delta;
    return config;
  };
  for (const bool by_upload : {false, true}) {
    const auto number = [&](int i) { return 10 * by_upload + i; };
    const std::string id = Put(*store, StripObj(number(1), 64), "", with_delta(5))->info.id;
    ASSERT_TRUE(AwaitTree(*store, id).ok());
    gate.Close();
    const std::string building = Put(*store, StripObj(number(2), 64))->info.id;
    ASSERT_TRUE(AwaitTree(*store, building, false).ok());
    const std::string waiting = Put(*store, StripObj(number(3), 64))->info.id;

    ExpectOver(store->Rebuild(id, with_delta(6)).status(), "--max-queued-builds");
    EXPECT_EQ(store->Get(id)->config.delta, 5u);
    if (by_upload) {
      ASSERT_TRUE(Put(*store, StripObj(number(1), 64), "", with_delta(7)).ok());
    } else {
      ASSERT_TRUE(other->Rebuild(id, with_delta(7)).ok());
    }
    ASSERT_TRUE(Eventually([&] { return store->Get(id)->config.delta == 7; }, std::chrono::seconds(5)));
    // The old tree goes on to answer, but is not told to be the new one.
    EXPECT_TRUE(AwaitTree(*store, id).ok());
    EXPECT_EQ(store->Statistics(id)->statistics.config.delta, 5u);
    EXPECT_EQ(store->Get(id)->state, MeshState::kBuilding);
    for (const bool start : {true, false}) {
      const absl::StatusOr<BuildReport> report = store->Watch(id, start);
      ASSERT_TRUE(report.ok()) << report.status();
      EXPECT_EQ(report->state, MeshState::kBuilding);
      EXPECT_EQ(report->build_number, 0u);
      EXPECT_TRUE(report->answers);
    }

    const uint64_t last = store->Watch(waiting)->build_number;
    gate.Open();
    ASSERT_TRUE(AwaitTree(*store, waiting).ok());
    if (by_upload) {
      EXPECT_TRUE(store->Watch(id, /*start=*/false).ok());
    } else {
      EXPECT_TRUE(AwaitTree(*store, id).ok());
    }
    // Those who asked in vain have taken no number. (One was taken when the queue was found full.)
    EXPECT_EQ(store->Watch(id)->build_number, last + 2);
    EXPECT_TRUE(
        Eventually([&] { return store->Statistics(id)->statistics.config.delta == 7; }, std::chrono::seconds(5)));
  }
}

TEST(BudgetsTest, BuildsThatWaitAreLimited) {
  ScratchDirectory directory;
  Gate gate;
  MeshStore::Options options;
  options.max_queued_builds = 1;
  options.on_delta_leaf = [&] { gate.Pass(); };
  auto store = OpenStore(directory.path(), options);
  gate.Close();
  const std::string building = Put(*store, StripObj(1, 64))->info.id;
  ASSERT_TRUE(AwaitTree(*store, building, false).ok());
  const std::string waiting = Put(*store, StripObj(2, 64))->info.id;
  // Stored all the same.
  const auto third = Put(*store, StripObj(3, 64));
  ASSERT_TRUE(third.ok()) << third.status();
  EXPECT_EQ(store->Get(third->info.id)->state, MeshState::kStored);
  ExpectOver(AwaitTree(*store, third->info.id).status(), "limit of 1 builds that wait is met (--max-queued-builds)");
  ExpectOver(store->Watch(third->info.id).status(), "--max-queued-builds");
  ExpectOver(store->Rebuild(building, {}).status(), "--max-queued-builds");
  // The build that waits is replaced by its mesh's new one.
  EXPECT_TRUE(store->Rebuild(waiting, {}).ok());
  // A mesh that is deleted leaves the queue.
  EXPECT_TRUE(store->Delete(waiting).ok());
  auto built = FutureTree(*store, third->info.id, true);
  gate.Open();
  EXPECT_TRUE(built.get().ok());
}

}  // namespace
}  // namespace deltaray
