// The life of builds in the store, with builds that stop at their δ-leaves until they are let go on.

#include "server/store/mesh_entry.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <new>
#include <optional>
#include <string>
#include <thread>

#include "tests/gate.h"
#include "tests/unit/store/fixture.h"

namespace deltaray {
namespace {

using ::testing::HasSubstr;

class MeshEntryTest : public ::testing::Test {
 protected:
  explicit MeshEntryTest(uint32_t concurrent_builds = 1) {
    MeshStore::Options options;
    options.concurrent_builds = concurrent_builds;
    options.on_delta_leaf = [this] {
      gate_.Pass();
      if (no_memory_) throw std::bad_alloc();
    };
    store_ = OpenStore(directory_.path(), options);
  }
  ~MeshEntryTest() override { gate_.Open(); }

  std::string Upload(int number, std::optional<Config> config = std::nullopt) {
    const auto put = Put(*store_, StripObj(number, 64), "", config);
    EXPECT_TRUE(put.ok()) << put.status();
    return put->info.id;
  }
  MeshState State(const std::string& id) { return store_->Get(id)->state; }
  void AwaitState(const std::string& id, MeshState state) {
    while (State(id) != state) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  template <typename Future>
  static bool IsReady(Future& future) {
    return future.wait_for(std::chrono::milliseconds(20)) == std::future_status::ready;
  }

  ScratchDirectory directory_;
  Gate gate_;
  std::atomic<bool> no_memory_{false};
  std::unique_ptr<MeshStore> store_;
};

class TwoBuildsTest : public MeshEntryTest {
 protected:
  TwoBuildsTest() : MeshEntryTest(2) {}
};

TEST_F(MeshEntryTest, TheProvisionalTreeAnswersBeforeTheFinalOneStands) {
  gate_.Close();
  const std::string id = Upload(1);
  auto final = FutureTree(*store_, id, true);
  const auto provisional = AwaitTree(*store_, id, false);
  ASSERT_TRUE(provisional.ok()) << provisional.status();
  EXPECT_FALSE(provisional->snapshot->final);
  EXPECT_EQ(State(id), MeshState::kProvisional);
  EXPECT_FALSE(IsReady(final));
  const Hit hit = HitStrip(*provisional, 1);
  EXPECT_EQ(hit.t, 1);
  store_->NoteAnswer(*provisional);
  const auto statistics = store_->Statistics(id);
  EXPECT_GT(statistics->first_answer_seconds, 0);
  EXPECT_EQ(statistics->statistics.total_seconds, 0);

  gate_.Open();
  const auto answer = final.get();
  ASSERT_TRUE(answer.ok()) << answer.status();
  EXPECT_TRUE(answer->snapshot->final);
  EXPECT_EQ(HitStrip(*answer, 1), hit);
  EXPECT_EQ(HitStrip(*provisional, 1), hit);
  EXPECT_EQ(State(id), MeshState::kReady);
  EXPECT_GT(store_->Statistics(id)->statistics.total_seconds, store_->Statistics(id)->first_answer_seconds);
}

TEST_F(MeshEntryTest, OnceNobodyMayWaitOnlyTreesThatStandAnswer) {
  gate_.Close();
  const std::string first = Upload(1);
  auto waits = FutureTree(*store_, first, true);
  ASSERT_TRUE(AwaitTree(*store_, first, false).ok());
  EXPECT_FALSE(IsReady(waits));

  store_->StopWaiting(absl::UnavailableError("enough"));
  EXPECT_EQ(waits.get().status(), absl::UnavailableError("enough"));
  EXPECT_TRUE(AwaitTree(*store_, first, false).ok());
  // The second one waits in the queue, which builds one mesh at a time.
  for (const auto& late : {FutureTree(*store_, first, true).share(), FutureTree(*store_, Upload(2), false).share()}) {
    ASSERT_TRUE(IsReady(late));
    EXPECT_EQ(late.get().status(), absl::UnavailableError("enough"));
  }

  gate_.Open();
  AwaitState(first, MeshState::kReady);
  EXPECT_TRUE(AwaitTree(*store_, first, true).ok());
}

TEST_F(MeshEntryTest, TheOldTreesAnswerUntilTheNewOnesCan) {
  const std::string id = Upload(1);
  const auto old_final = AwaitTree(*store_, id, true);
  gate_.Close();
  ASSERT_TRUE(store_->Rebuild(id, {}).ok());
  AwaitState(id, MeshState::kProvisional);
  // For rays that take any tree the new one can answer; for those that want a final one, the old one does.
  EXPECT_EQ(AwaitTree(*store_, id, true)->snapshot, old_final->snapshot);
  while (AwaitTree(*store_, id, false)->snapshot == old_final->snapshot) std::this_thread::yield();
  EXPECT_FALSE(AwaitTree(*store_, id, false)->snapshot->final);
  EXPECT_EQ(store_->Statistics(id)->build_number, 2u);
  gate_.Open();
  AwaitState(id, MeshState::kReady);
  while (AwaitTree(*store_, id, true)->snapshot == old_final->snapshot) std::this_thread::yield();
  EXPECT_TRUE(AwaitTree(*store_, id, true)->snapshot->final);
}

TEST_F(MeshEntryTest, RebuildCancelsTheBuildUnderWayAndItsWaitersGetTheNewTree) {
  gate_.Close();
  const std::string id = Upload(1);
  auto final = FutureTree(*store_, id, true);
  const auto provisional = AwaitTree(*store_, id, false);
  Config config;
  config.builder = Builder::kBvh;
  ASSERT_TRUE(store_->Rebuild(id, config).ok());
  EXPECT_EQ(AwaitTree(*store_, id, false)->snapshot, provisional->snapshot);
  EXPECT_EQ(store_->Watch(id)->build_number, 2u);
  EXPECT_EQ(State(id), MeshState::kBuilding);
  gate_.Open();
  const auto answer = final.get();
  ASSERT_TRUE(answer.ok()) << answer.status();
  EXPECT_TRUE(answer->snapshot->final);
  EXPECT_EQ(store_->Statistics(id)->build_number, 2u);
  EXPECT_EQ(store_->Statistics(id)->statistics.config.builder, Builder::kBvh);
}

TEST_F(MeshEntryTest, WhoWaitsForAMeshThatIsDeletedIsTold) {
  gate_.Close();
  const std::string id = Upload(1);
  auto final = FutureTree(*store_, id, true);
  const auto provisional = AwaitTree(*store_, id, false);
  ASSERT_TRUE(store_->Delete(id).ok());  // does not wait for the build, which stands at the gate
  EXPECT_EQ(final.get().status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(HitStrip(*provisional, 1).t, 1);
  // The same mesh, uploaded again, is built anew once the old build has ended.
  Upload(1);
  gate_.Open();
  EXPECT_TRUE(AwaitTree(*store_, id, true).ok());
  EXPECT_EQ(store_->Watch(id)->build_number, 2u);
}

TEST_F(MeshEntryTest, WhoWaitsWhenTheStoreGoesIsTold) {
  gate_.Close();
  const std::string building = Upload(1);
  const std::string queued = Upload(2);
  auto first = FutureTree(*store_, building, true);
  auto second = FutureTree(*store_, queued, false);
  EXPECT_TRUE(AwaitTree(*store_, building, false).ok());
  std::thread opener([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    gate_.Open();
  });
  store_.reset();
  EXPECT_EQ(first.get().status().code(), absl::StatusCode::kUnavailable);
  EXPECT_EQ(second.get().status().code(), absl::StatusCode::kUnavailable);
  opener.join();
}

TEST_F(MeshEntryTest, BuildsWaitForTheirTurn) {
  gate_.Close();
  const std::string first = Upload(1);
  const std::string second = Upload(2);
  AwaitState(first, MeshState::kProvisional);
  const auto report = store_->Watch(second);
  EXPECT_EQ(report->state, MeshState::kBuilding);
  EXPECT_EQ(report->progress.phase, BuildPhase::kQueued);
  EXPECT_EQ(report->progress.triangles, 128u);
  EXPECT_EQ(report->build_number, 2u);
  gate_.Open();
  EXPECT_TRUE(AwaitTree(*store_, second, true).ok());
  EXPECT_EQ(State(first), MeshState::kReady);
}

TEST_F(TwoBuildsTest, TwoBuildsMayRunAtOnce) {
  gate_.Close();
  const std::string first = Upload(1);
  const std::string second = Upload(2);
  AwaitState(first, MeshState::kProvisional);
  AwaitState(second, MeshState::kProvisional);
}

TEST_F(MeshEntryTest, AMeshOnlyStoredIsLoadedAndBuiltInTheBackground) {
  const std::string id = Upload(1);
  AwaitState(id, MeshState::kReady);
  store_.reset();
  gate_.Close();
  MeshStore::Options options;
  options.on_delta_leaf = [this] { gate_.Pass(); };
  store_ = OpenStore(directory_.path(), options);
  EXPECT_EQ(State(id), MeshState::kStored);
  auto final = FutureTree(*store_, id, true);  // returns though the build cannot end
  EXPECT_TRUE(AwaitTree(*store_, id, false).ok());
  gate_.Open();
  EXPECT_TRUE(final.get().ok());
  EXPECT_EQ(store_->Watch(id)->build_number, 1u);
}

TEST_F(MeshEntryTest, ACallbackMayUseTheStore) {
  gate_.Close();
  const std::string id = Upload(1);
  std::promise<absl::StatusOr<MeshStore::Answer>> promise;
  store_->WithTree(id, true, [&](absl::StatusOr<MeshStore::Answer>) {
    EXPECT_TRUE(store_->Get(id).ok());
    EXPECT_TRUE(store_->Name("from a callback", id).ok());
    store_->WithTree(id, true, [&](absl::StatusOr<MeshStore::Answer> answer) { promise.set_value(answer); });
  });
  gate_.Open();
  EXPECT_TRUE(promise.get_future().get().ok());
}

TEST_F(MeshEntryTest, ThoseWhoDoNotWaitAnyMoreAreForgotten) {
  gate_.Close();
  const std::string id = Upload(1);
  std::atomic<bool> cancelled{false};
  const auto held = std::make_shared<int>();
  store_->WithTree(
      id, true, [held](absl::StatusOr<MeshStore::Answer>) { ADD_FAILURE() << "called"; },
      [&] { return cancelled.load(); });
  auto other = FutureTree(*store_, id, true);
  store_->ForgetCancelled();
  EXPECT_EQ(held.use_count(), 2);
  cancelled = true;
  store_->ForgetCancelled();
  EXPECT_EQ(held.use_count(), 1);
  gate_.Open();
  EXPECT_TRUE(other.get().ok());
  store_->ForgetCancelled();
}

TEST_F(MeshEntryTest, ABuildThatFailsLateGivesBackWhatItTookBesideItsTree) {
  gate_.Close();
  no_memory_ = true;
  const std::string id = Upload(1);
  ASSERT_TRUE(AwaitTree(*store_, id, false).ok());
  const uint64_t building = store_->Usage().budget_bytes;
  gate_.Open();
  AwaitState(id, MeshState::kFailed);
  EXPECT_THAT(store_->Get(id)->failure, HasSubstr("not enough memory"));
  const uint64_t failed = store_->Usage().budget_bytes;
  EXPECT_LT(failed, building / 4);
  // Its provisional tree goes on to answer.
  EXPECT_GT(failed, 0u);
  EXPECT_EQ(HitStrip(*AwaitTree(*store_, id, false), 1).t, 1);
}

TEST_F(MeshEntryTest, ALazyBuildIsOverOnceItsTopStands) {
  Config config;
  config.lazy = true;
  config.delta = 4;
  const std::string id = Upload(1, config);
  const auto answer = AwaitTree(*store_, id, true);
  ASSERT_TRUE(answer.ok()) << answer.status();
  EXPECT_EQ(State(id), MeshState::kProvisional);
  EXPECT_EQ(HitStrip(*answer, 1).t, 1);
  EXPECT_EQ(store_->Watch(id)->progress.phase, BuildPhase::kDone);
}

// Over many small builds, so that reports fall between their steps.
TEST_F(MeshEntryTest, ProgressNeverGoesBack) {
  const std::string id = Upload(1);
  for (int build = 0; build < 200; ++build) {
    double last = 0;
    std::optional<BuildReport> report;
    do {
      report = *store_->Watch(id);
      ASSERT_GE(report->progress.elapsed_seconds, last) << "build " << build;
      last = report->progress.elapsed_seconds;
    } while (report->state != MeshState::kReady);
    EXPECT_EQ(report->progress.phase, BuildPhase::kDone);
    EXPECT_EQ(report->progress.delta_leaves_built, report->progress.delta_leaves);
    ASSERT_TRUE(store_->Rebuild(id, {}).ok());
  }
}

}  // namespace
}  // namespace deltaray
