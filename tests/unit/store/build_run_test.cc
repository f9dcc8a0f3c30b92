#include "server/store/build_run.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <new>
#include <thread>

#include "tests/scenes/made.h"

namespace deltaray {
namespace {

// Such a build must not go on beside the next one of its mesh, with its memory given back.
TEST(BuildRunTest, ABuildWhoseProvisionalTreeFindsNoMemoryIsOver) {
  const auto mesh = std::make_shared<const TriangleMesh>(Soup(5'000));
  const auto budget = std::make_shared<TreeBudget>(uint64_t{1} << 30, [](uint64_t) { return false; });
  std::atomic<int> delta_leaves{0};
  BuildRun run(1, Config(), mesh->indices.size());
  run.Hold(*budget->Reserve(100 << 20, "mesh", [] { return false; }));
  const absl::Status status = run.Run([&](const auto&) { return mesh; },
                                      {.config = {},
                                       .threads = 2,
                                       .on_delta_leaf =
                                           [&delta_leaves] {
                                             ++delta_leaves;
                                             std::this_thread::sleep_for(std::chrono::milliseconds(10));
                                           }},
                                      [] { throw std::bad_alloc(); });
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted) << status;
  EXPECT_TRUE(run.has_ended());
  const int before = delta_leaves;
  EXPECT_LT(static_cast<uint64_t>(before), run.Report().progress.delta_leaves);
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  EXPECT_EQ(delta_leaves, before);
  // The tree that stood answers on, and counts as much as it takes.
  ASSERT_NE(run.snapshot(), nullptr);
  EXPECT_EQ(budget->used(),
            run.snapshot()->tree->Shape().node_bytes + run.snapshot()->tree->Shape().reference_bytes + mesh->Bytes());
}

}  // namespace
}  // namespace deltaray
