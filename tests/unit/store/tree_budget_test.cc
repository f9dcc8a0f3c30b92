#include "server/store/tree_budget.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <future>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "tests/eventually.h"

namespace deltaray {
namespace {

using ::testing::HasSubstr;

constexpr auto kNever = [] { return false; };
constexpr auto kNoRoom = [](uint64_t) { return false; };

using Reservations = std::vector<std::shared_ptr<TreeBudget::Reservation>>;

TEST(TreeBudgetTest, WhatIsReservedIsGivenBack) {
  const auto budget = std::make_shared<TreeBudget>(100, kNoRoom);
  {
    auto a = *budget->Reserve(60, "a", kNever);
    EXPECT_EQ(budget->used(), 60u);
    auto b = a->Split(20);
    EXPECT_EQ(budget->used(), 60u);
    a->ShrinkTo(10);
    EXPECT_EQ(budget->used(), 30u);
    a.reset();
    EXPECT_EQ(budget->used(), 20u);
    EXPECT_TRUE(b->GrowTo(100).ok());
    EXPECT_EQ(budget->used(), 100u);
  }
  EXPECT_EQ(budget->used(), 0u);
}

TEST(TreeBudgetTest, WhatCanNeverFitIsRefusedAtOnce) {
  const auto budget = std::make_shared<TreeBudget>(100, kNoRoom);
  const absl::Status status = budget->Reserve(101, "the mesh", kNever).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(status.ToString(), HasSubstr("the mesh takes up to 101 bytes"));
  EXPECT_THAT(status.ToString(), HasSubstr("100 bytes (--tree-bytes)"));
  EXPECT_THAT(budget->Empty()->GrowTo(101).ToString(), HasSubstr("100 bytes (--tree-bytes)"));
}

TEST(TreeBudgetTest, OthersMakeRoom) {
  Reservations trees;
  const auto budget = std::make_shared<TreeBudget>(100, [&](uint64_t bytes) {
    EXPECT_EQ(bytes, 60u);
    trees.resize(1);
    return true;
  });
  for (int i = 0; i < 4; ++i) trees.push_back(*budget->Reserve(25, "a", kNever));
  const auto big = budget->Reserve(60, "b", kNever);
  EXPECT_TRUE(big.ok());
  EXPECT_EQ(trees.size(), 1u);
  EXPECT_EQ(budget->used(), 85u);
}

TEST(TreeBudgetTest, WhoFindsNoRoomWaitsUntilThereIsSomeOrItIsCancelled) {
  const auto budget = std::make_shared<TreeBudget>(100, kNoRoom);
  auto a = *budget->Reserve(60, "a", kNever);
  std::atomic<bool> cancelled{false};
  auto waits =
      std::async(std::launch::async, [&] { return budget->Reserve(50, "b", [&] { return cancelled.load(); }); });
  EXPECT_EQ(waits.wait_for(std::chrono::milliseconds(50)), std::future_status::timeout);
  cancelled = true;
  EXPECT_EQ(waits.get().status().code(), absl::StatusCode::kCancelled);
  waits = std::async(std::launch::async, [&] { return budget->Reserve(50, "b", kNever); });
  a.reset();
  EXPECT_TRUE(waits.get().ok());
}

TEST(TreeBudgetTest, WhatWasDroppedIsWaitedForBeforeMoreIsDropped) {
  Reservations in_use;
  std::atomic<int> asked{0};
  const auto budget = std::make_shared<TreeBudget>(100, [&](uint64_t bytes) {
    EXPECT_EQ(bytes, 20u);
    if (asked == 0) in_use[0]->Retire();
    return ++asked == 1;
  });
  for (int i = 0; i < 4; ++i) in_use.push_back(*budget->Reserve(25, "a", kNever));
  auto waits = std::async(std::launch::async, [&] { return budget->Reserve(20, "b", kNever); });
  ASSERT_TRUE(Eventually([&] { return asked == 1; }));
  EXPECT_EQ(waits.wait_for(std::chrono::milliseconds(100)), std::future_status::timeout);
  EXPECT_EQ(asked, 1);
  in_use[0].reset();
  EXPECT_TRUE(waits.get().ok());
  EXPECT_EQ(asked, 1);
}

TEST(TreeBudgetTest, WhoIsCancelledNeedNotWaitForItsTurn) {
  const auto budget = std::make_shared<TreeBudget>(100, kNoRoom);
  auto a = *budget->Reserve(60, "a", kNever);
  std::atomic<bool> waits{false};
  auto first = std::async(std::launch::async, [&] {
    return budget->Reserve(90, "b", [&] {
      waits = true;
      return false;
    });
  });
  ASSERT_TRUE(Eventually([&] { return waits.load(); }));
  // There is room for this one, but the first one has waited for longer.
  std::atomic<bool> cancelled{false};
  auto second =
      std::async(std::launch::async, [&] { return budget->Reserve(10, "c", [&] { return cancelled.load(); }); });
  EXPECT_EQ(second.wait_for(std::chrono::milliseconds(50)), std::future_status::timeout);
  cancelled = true;
  EXPECT_EQ(second.get().status().code(), absl::StatusCode::kCancelled);
  a.reset();
  EXPECT_TRUE(first.get().ok());
}

TEST(TreeBudgetTest, MoreThanWasReservedIsCountedToo) {
  const auto budget = std::make_shared<TreeBudget>(100, kNoRoom);
  auto a = *budget->Reserve(60, "a", kNever);
  const auto b = a->Split(120);
  EXPECT_EQ(budget->used(), 120u);
  a.reset();
  EXPECT_EQ(budget->used(), 120u);
}

}  // namespace
}  // namespace deltaray
