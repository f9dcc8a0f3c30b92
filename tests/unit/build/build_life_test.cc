// How long builds live, who hears of their end, and what ends them early.

#include <atomic>
#include <chrono>
#include <future>
#include <new>
#include <thread>

#include "gtest/gtest.h"
#include "server/build/build.h"
#include "tests/gate.h"
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

TEST(BuildLifeTest, WhatThereWasAnswersAfterACancel) {
  Gate gate;
  gate.Close();
  const std::shared_ptr<Build> build = Start(Shared(Soup(2000)), Config(), 1, [&] { gate.Pass(); });
  std::future<absl::Status> final = std::async(std::launch::async, [&] { return build->WaitDone(); });
  ASSERT_TRUE(build->WaitProvisional().ok());
  EXPECT_EQ(final.wait_for(milliseconds(20)), std::future_status::timeout);
  build->Cancel();
  gate.Open();
  EXPECT_EQ(final.get().code(), absl::StatusCode::kCancelled);
  EXPECT_EQ(build->WaitDone().code(), absl::StatusCode::kCancelled);
  EXPECT_TRUE(build->WaitProvisional().ok());
  EXPECT_FALSE(build->snapshot()->final);
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
