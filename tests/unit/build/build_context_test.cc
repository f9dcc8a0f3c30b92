#include "server/build/build_context.h"

#include <chrono>
#include <thread>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace deltaray {
namespace {

using testing::ElementsAre;

// Keeps the processor busy; sleeping takes no processor time.
void Work(double seconds) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
  while (std::chrono::steady_clock::now() < end) {
  }
}

TEST(BuildContextTest, HistogramCountsByPowersOfTwo) {
  BuildContext context;
  for (const uint32_t size : {1, 2, 3, 4, 7, 32}) context.CountDeltaLeaf(size);
  EXPECT_EQ(context.delta_leaves, 6u);
  EXPECT_THAT(context.delta_leaf_size_histogram(), ElementsAre(1, 2, 2, 0, 0, 1));
}

TEST(BuildContextTest, KeepsThePeakOfBytes) {
  BuildContext context;
  context.CountBytes(100);
  context.CountBytes(50);
  context.CountBytes(-120);
  context.CountBytes(60);
  EXPECT_EQ(context.peak_bytes(), 150u);
}

TEST(BuildContextTest, PhasesFollowEachOther) {
  BuildContext context;
  EXPECT_TRUE(context.phases().empty());
  context.EnterPhase(BuildPhase::kReferences);
  context.EnterPhase(BuildPhase::kTop);
  std::this_thread::sleep_for(std::chrono::milliseconds(20));
  context.EnterPhase(BuildPhase::kDone);
  const std::vector<PhaseTime> phases = context.phases();
  ASSERT_EQ(phases.size(), 2u);
  EXPECT_EQ(phases[0].phase, BuildPhase::kReferences);
  EXPECT_EQ(phases[1].phase, BuildPhase::kTop);
  EXPECT_GE(phases[1].wall_seconds, 0.02);
  EXPECT_EQ(phases[1].cpu_seconds, 0);
  // The clock has stopped.
  const double elapsed = context.elapsed_seconds();
  std::this_thread::sleep_for(std::chrono::milliseconds(5));
  EXPECT_EQ(context.elapsed_seconds(), elapsed);
}

TEST(BuildContextTest, ProcessorTimeOfNestedTasksCountsOnce) {
  BuildContext context;
  context.EnterPhase(BuildPhase::kTop);
  std::thread([&] {
    const BuildContext::CpuTime outer(context);
    {
      const BuildContext::CpuTime inner(context);
      Work(0.05);
    }
    Work(0.01);
  }).join();
  const double cpu_seconds = context.phases().at(0).cpu_seconds;
  EXPECT_GT(cpu_seconds, 0);
  EXPECT_LE(cpu_seconds, context.phases().at(0).wall_seconds);
}

TEST(BuildContextTest, ProcessorTimeAddsUpOverThreads) {
  BuildContext context;
  context.EnterPhase(BuildPhase::kTop);
  const auto count = [&] {
    const BuildContext::CpuTime time(context);
    Work(0.02);
  };
  std::thread(count).join();
  const double once = context.phases().at(0).cpu_seconds;
  std::thread(count).join();
  EXPECT_GT(context.phases().at(0).cpu_seconds, once);
}

// The δ-leaves of a lazy build are built after it has ended.
TEST(BuildContextTest, TimeOfAPhaseThatWasNeverEnteredIsCounted) {
  BuildContext context;
  context.EnterPhase(BuildPhase::kDone);
  std::thread([&] {
    const BuildContext::CpuTime time(context, BuildPhase::kDeltaLeaves);
    Work(0.01);
  }).join();
  const std::vector<PhaseTime> phases = context.phases();
  ASSERT_EQ(phases.size(), 1u);
  EXPECT_EQ(phases[0].phase, BuildPhase::kDeltaLeaves);
  EXPECT_GT(phases[0].cpu_seconds, 0);
  EXPECT_EQ(phases[0].wall_seconds, 0);
}

}  // namespace
}  // namespace deltaray
