#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>

#include "tests/torture/history.h"

namespace deltaray {
namespace {

using ::testing::IsEmpty;
using ::testing::SizeIs;

using Kind = Event::Kind;
using Outcome = Event::Outcome;

constexpr std::chrono::nanoseconds kExact{0};

Event Upload(int64_t begin, int64_t end, int mesh, int name = -1, Outcome outcome = Outcome::kDone) {
  return {Kind::kUpload, begin, end, outcome, mesh, name};
}
Event Move(int64_t begin, int64_t end, int mesh, int name, Outcome outcome = Outcome::kDone) {
  return {Kind::kMove, begin, end, outcome, mesh, name};
}
Event Delete(int64_t begin, int64_t end, int mesh, Outcome outcome = Outcome::kDone) {
  return {Kind::kDelete, begin, end, outcome, mesh, -1};
}
Event Ask(int64_t begin, int64_t end, int mesh, int name = -1, Outcome outcome = Outcome::kDone) {
  return {Kind::kAsk, begin, end, outcome, mesh, name};
}
Event Missing(int64_t begin, int64_t end, int mesh, int name = -1) {
  return Ask(begin, end, mesh, name, Outcome::kNotFound);
}

TEST(CheckHistoryTest, AMeshAnswersFromItsUploadToItsDelete) {
  EXPECT_THAT(CheckHistory({Upload(10, 20, 0), Ask(15, 16, 0), Ask(30, 31, 0)}, kExact), IsEmpty());
  EXPECT_THAT(CheckHistory({Upload(10, 20, 0), Ask(5, 9, 0)}, kExact), SizeIs(1));
  EXPECT_THAT(CheckHistory({Upload(10, 20, 1), Ask(30, 31, 0)}, kExact), SizeIs(1));
  const std::vector<Event> deleted = {Upload(10, 20, 0), Delete(30, 40, 0), Ask(50, 51, 0)};
  EXPECT_THAT(CheckHistory(deleted, kExact), SizeIs(1));
  EXPECT_THAT(CheckHistory(deleted, std::chrono::nanoseconds(20)), IsEmpty());
  EXPECT_THAT(CheckHistory({Upload(10, 20, 0), Delete(30, 40, 0), Ask(35, 51, 0)}, kExact), IsEmpty());
  EXPECT_THAT(CheckHistory({Upload(10, 35, 0), Delete(30, 40, 0), Ask(50, 51, 0)}, kExact), IsEmpty());
}

TEST(CheckHistoryTest, AMeshThatStandsIsFound) {
  EXPECT_THAT(CheckHistory({Upload(10, 20, 0), Missing(15, 16, 0), Missing(5, 9, 0)}, kExact), IsEmpty());
  EXPECT_THAT(CheckHistory({Upload(10, 20, 0), Missing(30, 31, 0)}, kExact), SizeIs(1));
  EXPECT_THAT(CheckHistory({Upload(10, 20, 0), Delete(25, 40, 0), Missing(30, 31, 0)}, kExact), IsEmpty());
  EXPECT_THAT(CheckHistory({Delete(1, 5, 0), Upload(10, 20, 0), Missing(30, 31, 0)}, kExact), SizeIs(1));
  EXPECT_THAT(CheckHistory({Upload(10, 20, 0), Delete(22, 23, 0, Outcome::kNotFound), Missing(30, 31, 0)}, kExact),
              SizeIs(1));
}

TEST(CheckHistoryTest, WhatWasNotAcknowledgedMayHaveHappenedThenOrLater) {
  EXPECT_THAT(CheckHistory({Upload(10, 20, 0, -1, Outcome::kUnknown), Ask(30, 31, 0), Missing(40, 41, 0)}, kExact),
              IsEmpty());
  EXPECT_THAT(
      CheckHistory({Upload(10, 20, 0), Delete(22, 23, 0, Outcome::kUnknown), Ask(30, 31, 0), Missing(40, 41, 0)},
                   kExact),
      IsEmpty());
}

TEST(CheckHistoryTest, ANameLeadsWhereItPoints) {
  const std::vector<Event> moves = {Upload(1, 2, 0, 5), Upload(1, 2, 1), Move(10, 20, 1, 5)};
  const auto check = [&](Event ask) {
    std::vector<Event> events = moves;
    events.push_back(ask);
    return CheckHistory(events, kExact);
  };
  EXPECT_THAT(check(Ask(3, 4, 0, 5)), IsEmpty());
  EXPECT_THAT(check(Ask(3, 4, 1, 5)), SizeIs(1));
  EXPECT_THAT(check(Ask(12, 13, 0, 5)), IsEmpty());
  EXPECT_THAT(check(Ask(12, 13, 1, 5)), IsEmpty());
  EXPECT_THAT(check(Ask(30, 31, 0, 5)), SizeIs(1));
  EXPECT_THAT(check(Missing(30, 31, 0, 5)), SizeIs(1));
  EXPECT_THAT(check(Missing(30, 31, 0, 4)), IsEmpty());
  std::vector<Event> deleted = moves;
  deleted.push_back(Delete(22, 23, 1));
  deleted.push_back(Missing(30, 31, 0, 5));
  EXPECT_THAT(CheckHistory(deleted, kExact), IsEmpty());
}

}  // namespace
}  // namespace deltaray
