// How long builds live, who hears of their end, and what ends them early.

#include <atomic>
#include <chrono>
#include <future>
#include <new>
#include <thread>

#include "gtest/gtest.h"
#include "server/build/build.h"
#include "tests/scenes/made.h"
#include "tests/unit/build/builds.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

using std::chrono::milliseconds;

TEST(BuildLifeTest, SnapshotsOutliveTheBuildAndTheMesh) {
  std::shared_ptr<const TreeSnapshot> snapshot;
  {
    const std::shared_ptr<Build> build = Start(Shared(Soup(500)), Config());
    ASSERT_TRUE(build->WaitDone().ok());
    snapshot = build->snapshot();
  }
  const std::shared_ptr<const Tree> tree = snapshot->tree;
  const std::weak_ptr<const TriangleMesh> mesh = snapshot->mesh;
  snapshot = nullptr;
  EXPECT_FALSE(mesh.expired()) << "the tree lost its mesh";
  const std::vector<Ray> rays = ChordRays({{0, 0, 0}, {1, 1, 1}}, 100, 1);
  EXPECT_TRUE(Answers(*tree, rays) == Answers(BruteForce(mesh.lock()->triangles()), rays));
}

TEST(BuildLifeTest, DestroyingARunningBuildCancelsIt) {
  const auto mesh = Shared(Soup(3000));
  std::atomic<int> running{0}, begun{0};
  {
    const std::shared_ptr<Build> build = Start(mesh, Config(), 2, [&] {
      ++begun;
      ++running;
      std::this_thread::sleep_for(milliseconds(2));
      --running;
    });
    ASSERT_TRUE(build->WaitProvisional().ok());
    while (begun == 0) std::this_thread::yield();
  }
  EXPECT_EQ(running, 0);
  const int begun_by_then = begun;
  std::this_thread::sleep_for(milliseconds(20));
  EXPECT_EQ(begun, begun_by_then);
}

TEST(BuildLifeTest, CallbacksComeOnceEach) {
  Gate gate;
  const std::shared_ptr<Build> build = Start(Shared(Soup(500)), Config(), 2, gate.Pass());
  std::promise<absl::Status> provisional, final;
  std::atomic<bool> final_came{false};
  build->OnSnapshot(false, [&](absl::Status status) { provisional.set_value(status); });
  build->OnSnapshot(true, [&](absl::Status status) {
    final_came = true;
    final.set_value(status);
  });
  EXPECT_TRUE(provisional.get_future().get().ok());
  EXPECT_NE(build->snapshot(), nullptr);
  EXPECT_FALSE(final_came);
  gate.Open();
  EXPECT_TRUE(final.get_future().get().ok());
  EXPECT_TRUE(build->snapshot()->final);
  // From now on at once.
  int calls = 0;
  for (const bool wants_final : {false, true}) build->OnSnapshot(wants_final, [&](absl::Status) { ++calls; });
  EXPECT_EQ(calls, 2);
}

TEST(BuildLifeTest, CallbacksHearOfCancellation) {
  Gate gate;
  const std::shared_ptr<Build> build = Start(Shared(Soup(2000)), Config(), 1, gate.Pass());
  std::promise<absl::Status> final;
  build->OnSnapshot(true, [&](absl::Status status) { final.set_value(status); });
  ASSERT_TRUE(build->WaitProvisional().ok());
  build->Cancel();
  gate.Open();
  EXPECT_EQ(final.get_future().get().code(), absl::StatusCode::kCancelled);
  EXPECT_EQ(build->WaitDone().code(), absl::StatusCode::kCancelled);
  // What there was still answers.
  EXPECT_TRUE(build->WaitProvisional().ok());
  EXPECT_FALSE(build->snapshot()->final);
}

TEST(BuildLifeTest, ACallbackMayDropTheLastReference) {
  for (const bool final : {false, true}) {
    std::shared_ptr<Build> build = Start(Shared(Soup(3000)), Config());
    std::promise<void> dropped;
    auto holder = std::make_shared<std::shared_ptr<Build>>(build);
    Build* const raw = build.get();
    build = nullptr;
    raw->OnSnapshot(final, [&dropped, holder](absl::Status) {
      *holder = nullptr;
      dropped.set_value();
    });
    holder = nullptr;
    dropped.get_future().wait();
  }
}

TEST(BuildLifeTest, CancelAfterTheEndDoesNothing) {
  const std::shared_ptr<Build> build = Start(Shared(Soup(500)), Config());
  ASSERT_TRUE(build->WaitDone().ok());
  build->Cancel();
  EXPECT_TRUE(build->WaitDone().ok());
  EXPECT_TRUE(build->snapshot()->final);
}

TEST(BuildLifeTest, LackOfMemoryIsAStatus) {
  const std::shared_ptr<Build> build = Start(Shared(Soup(500)), Config(), 2, [] { throw std::bad_alloc(); });
  const absl::Status status = build->WaitDone();
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(status.message(), "not enough memory to build the tree of 500 triangles");
}

}  // namespace
}  // namespace deltaray
