#include <gtest/gtest.h>

#include "client/build_watcher.h"
#include "client/progress_bar.h"
#include "tests/unit/client/test_session.h"

namespace deltaray {
namespace {

TEST(ProgressBarTest, DrawsAndClearsItsLine) {
  TestSession session;
  {
    ProgressBar bar(session.session().messages, /*enabled=*/true);
    bar.Update(0.5, "half");
    bar.Update(0.6, "too soon to be drawn");
  }
  EXPECT_EQ(session.TakeMessages(),
            "\r\033[K\033[?7l[############............]  50 %  half\033[?7h"
            "\r\033[K");
}

TEST(ProgressBarTest, DrawsNothingWhereNotEnabled) {
  TestSession session;
  {
    ProgressBar bar(session.session().messages, /*enabled=*/false);
    bar.Update(0.5, "half");
  }
  EXPECT_EQ(session.TakeMessages(), "");
}

TEST(BuildProgressTest, FractionGrowsOverThePhases) {
  v1::BuildProgress progress;
  progress.set_phase(v1::BUILD_PHASE_QUEUED);
  EXPECT_EQ(BuildFraction(progress), 0);
  progress.set_phase(v1::BUILD_PHASE_TOP);
  progress.set_triangles(1000);
  progress.set_references_placed(500);
  EXPECT_EQ(BuildFraction(progress), 0.25);
  EXPECT_EQ(BuildText(progress), "top: 500 references placed, 1,000 triangles");
  progress.set_references_placed(1300);
  EXPECT_EQ(BuildFraction(progress), 0.5);
  progress.set_phase(v1::BUILD_PHASE_DELTA_LEAVES);
  progress.set_delta_leaves(2000);
  progress.set_delta_leaves_built(500);
  EXPECT_EQ(BuildFraction(progress), 0.625);
  EXPECT_EQ(BuildText(progress), "δ-leaves: 500 of 2,000");
  progress.set_phase(v1::BUILD_PHASE_DONE);
  EXPECT_EQ(BuildFraction(progress), 1);
}

}  // namespace
}  // namespace deltaray
