#include "server/build/point_bins.h"

#include "gtest/gtest.h"
#include "tests/scenes/random.h"

namespace deltaray {
namespace {

TEST(PointBinsTest, AllAxesAtOnceAndOneGiveTheSame) {
  Random random(1);
  for (int round = 0; round < 1000; ++round) {
    const float size = static_cast<float>(std::pow(10.0, random.Uniform(-20, 20)));
    const Bounds bounds{{-size, 0, size}, {size, size, 3 * size}};
    const PointBins bins(PackedBounds(bounds), 16);
    Vec3f point;
    for (int axis = 0; axis < 3; ++axis) {
      point[axis] = bounds.min[axis] + static_cast<float>(random.Uniform()) * (bounds.max[axis] - bounds.min[axis]);
    }
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_EQ(bins.At(Pack(point))[axis], bins.At(point[axis], axis));
      EXPECT_EQ(bins.Before(Pack(point))[axis], bins.Before(point[axis], axis));
      EXPECT_GE(bins.At(point[axis], axis), 0);
      EXPECT_LT(bins.At(point[axis], axis), 16);
    }
  }
}

TEST(PointBinsTest, WhatTouchesAPlaneIsAboveItAndNotBefore) {
  const PointBins bins(PackedBounds(Bounds{{0, 0, 0}, {16, 16, 16}}), 16);
  for (int i = 0; i < 16; ++i) {
    const float x = static_cast<float>(i);
    EXPECT_EQ(bins.At(x, 1), i);
    EXPECT_EQ(bins.Before(x, 1), i - 1);
    EXPECT_EQ(bins.At(x + 0.5f, 1), i);
    EXPECT_EQ(bins.Before(x + 0.5f, 1), i);
  }
  EXPECT_EQ(bins.At(16.0f, 1), 15);
  EXPECT_EQ(bins.Before(16.0f, 1), 15);
}

TEST(PointBinsTest, DoesNotCutWhatHasNoWidth) {
  const PointBins flat(PackedBounds(Bounds{{0, 1, 0}, {1, 1, 1e-44f}}), 8);
  EXPECT_TRUE(flat.CanCut(0));
  EXPECT_FALSE(flat.CanCut(1));
  EXPECT_FALSE(flat.CanCut(2));
  EXPECT_EQ(flat.At(1.0f, 1), 0);
}

}  // namespace
}  // namespace deltaray
