#include "server/store/tree_budget.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <future>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"

namespace deltaray {
namespace {

using ::testing::HasSubstr;

constexpr auto kNever = [] { return false; };

TEST(TreeBudgetTest, WhatIsReservedIsGivenBack) {
  const auto budget = std::make_shared<TreeBudget>(100, kNever);
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
  const auto budget = std::make_shared<TreeBudget>(100, kNever);
  const absl::Status status = budget->Reserve(101, "the mesh", kNever).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(status.ToString(), HasSubstr("the mesh takes up to 101 bytes"));
  EXPECT_THAT(status.ToString(), HasSubstr("100 bytes (--tree-bytes)"));
  EXPECT_THAT(budget->Empty()->GrowTo(101).ToString(), HasSubstr("100 bytes (--tree-bytes)"));
}

TEST(TreeBudgetTest, OthersMakeRoom) {
  std::vector<std::shared_ptr<TreeBudget::Reservation>> trees;
  const auto budget = std::make_shared<TreeBudget>(100, [&] {
    if (trees.empty()) return false;
    trees.erase(trees.begin());
    return true;
  });
  for (int i = 0; i < 4; ++i) trees.push_back(*budget->Reserve(25, "a", kNever));
  const auto big = budget->Reserve(60, "b", kNever);
  EXPECT_TRUE(big.ok());
  EXPECT_EQ(trees.size(), 1u);
  EXPECT_EQ(budget->used(), 85u);
}

TEST(TreeBudgetTest, WhoFindsNoRoomWaitsUntilThereIsSomeOrItIsCancelled) {
  const auto budget = std::make_shared<TreeBudget>(100, kNever);
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

TEST(TreeBudgetTest, MoreThanWasReservedIsCountedToo) {
  const auto budget = std::make_shared<TreeBudget>(100, kNever);
  auto a = *budget->Reserve(60, "a", kNever);
  const auto b = a->Split(120);
  EXPECT_EQ(budget->used(), 120u);
  a.reset();
  EXPECT_EQ(budget->used(), 120u);
}

}  // namespace
}  // namespace deltaray
