#include "server/build/config.h"

#include <cmath>
#include <functional>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace deltaray {
namespace {

std::string MessageAfter(const std::function<void(Config&)>& change) {
  Config config;
  change(config);
  const absl::Status status = Validate(config);
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  return std::string(status.message());
}

TEST(ConfigTest, EveryPresetOfEveryBuilderIsValid) {
  for (const Builder builder :
       {Builder::kHybrid, Builder::kKdTree, Builder::kBvh, Builder::kSbvh, Builder::kTang2015}) {
    for (const Preset preset : {Preset::kFast, Preset::kBalanced, Preset::kBest, Preset::kAuto}) {
      const Config config = MakeConfig(builder, preset);
      EXPECT_TRUE(Validate(config).ok()) << Validate(config);
      EXPECT_EQ(config.builder, builder);
      EXPECT_EQ(config.preset, preset);
    }
  }
}

TEST(ConfigTest, TheBvhNeverSplitsInSpace) {
  EXPECT_EQ(MakeConfig(Builder::kBvh, Preset::kBest).spatial_split_gate, 1);
  EXPECT_EQ(MakeConfig(Builder::kBvh, Preset::kBest).duplication_budget, 0);
}

TEST(ConfigTest, OnlyTheAutoHybridLeavesDeltaToTheMesh) {
  EXPECT_EQ(MakeConfig(Builder::kHybrid, Preset::kAuto).delta, kDeltaByMesh);
  EXPECT_EQ(MessageAfter([](Config& c) {
              c = MakeConfig(Builder::kTang2015, Preset::kAuto);
              c.delta = kDeltaByMesh;
            }),
            "delta is 0; it must be 1 to 4096");
}

TEST(ConfigTest, ErrorsNameFieldValueAndRange) {
  EXPECT_EQ(MessageAfter([](Config& c) { c.delta = 0; }), "delta is 0; it must be 1 to 4096");
  EXPECT_EQ(MessageAfter([](Config& c) { c.delta = 4097; }), "delta is 4097; it must be 1 to 4096");
  EXPECT_EQ(MessageAfter([](Config& c) { c.delta = 4294967295; }), "delta is 4294967295; it must be 1 to 4096");
  EXPECT_EQ(MessageAfter([](Config& c) { c.alpha = 1.5; }), "alpha is 1.5; it must be 0 to 1");
  EXPECT_EQ(MessageAfter([](Config& c) { c.alpha = 1.0000001; }), "alpha is 1.0000001; it must be 0 to 1");
  EXPECT_EQ(MessageAfter([](Config& c) { c.alpha = std::nan(""); }), "alpha is nan; it must be 0 to 1");
  EXPECT_EQ(MessageAfter([](Config& c) { c.cluster_traversal_cost = 0; }),
            "cluster_traversal_cost is 0; it must be 0.001 to 1000");
  EXPECT_EQ(MessageAfter([](Config& c) { c.cluster_intersection_cost = 2000; }),
            "cluster_intersection_cost is 2000; it must be 0.001 to 1000");
  EXPECT_EQ(MessageAfter([](Config& c) { c.traversal_cost = -1; }), "traversal_cost is -1; it must be 0.001 to 1000");
  EXPECT_EQ(MessageAfter([](Config& c) { c.intersection_cost = INFINITY; }),
            "intersection_cost is inf; it must be 0.001 to 1000");
  EXPECT_EQ(MessageAfter([](Config& c) { c.max_leaf_size = 256; }), "max_leaf_size is 256; it must be 1 to 255");
  EXPECT_EQ(MessageAfter([](Config& c) { c.spatial_split_gate = -0.5; }),
            "spatial_split_gate is -0.5; it must be 0 to 1");
  EXPECT_EQ(MessageAfter([](Config& c) { c.duplication_budget = 17; }), "duplication_budget is 17; it must be 0 to 16");
}

TEST(ConfigTest, OnlyTheHybridIsLazy) {
  EXPECT_EQ(MessageAfter([](Config& c) {
              c.lazy = true;
              c.builder = Builder::kSbvh;
            }),
            "lazy is set; only the hybrid can be built lazily");
  Config hybrid;
  hybrid.lazy = true;
  EXPECT_TRUE(Validate(hybrid).ok());
}

}  // namespace
}  // namespace deltaray
