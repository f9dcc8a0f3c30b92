#include "server/store/record_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "server/store/sha256.h"

namespace deltaray {
namespace {

using ::testing::HasSubstr;

Config OddConfig() {
  Config config;
  config.preset = Preset::kBest;
  config.builder = Builder::kTang2015;
  config.delta = 77;
  config.alpha = 0.1;  // not exact in binary: needs all digits
  config.cluster_traversal_cost = 1.0 / 3;
  config.cluster_intersection_cost = 81;
  config.traversal_cost = 2;
  config.intersection_cost = 3;
  config.max_leaf_size = 4;
  config.spatial_split_gate = 1e-5;
  config.duplication_budget = 0.3;
  return config;
}

// With a checksum that fits, however wrong the rest may be.
std::string Sealed(const std::string& text) { return text + "sha256=" + Sha256::Hex(text) + "\n"; }

TEST(RecordFileTest, AConfigComesBackToTheBit) {
  const absl::StatusOr<Config> config = DecodeConfig(EncodeConfig(OddConfig()));
  ASSERT_TRUE(config.ok()) << config.status();
  EXPECT_EQ(config->preset, Preset::kBest);
  EXPECT_EQ(config->builder, Builder::kTang2015);
  EXPECT_EQ(config->delta, 77u);
  EXPECT_EQ(config->alpha, 0.1);
  EXPECT_EQ(config->cluster_traversal_cost, 1.0 / 3);
  EXPECT_EQ(config->cluster_intersection_cost, 81);
  EXPECT_EQ(config->traversal_cost, 2);
  EXPECT_EQ(config->intersection_cost, 3);
  EXPECT_EQ(config->max_leaf_size, 4u);
  EXPECT_EQ(config->spatial_split_gate, 1e-5);
  EXPECT_EQ(config->duplication_budget, 0.3);
  EXPECT_FALSE(config->lazy);

  Config lazy;
  lazy.lazy = true;
  EXPECT_TRUE(DecodeConfig(EncodeConfig(lazy))->lazy);

  const absl::StatusOr<Config> by_mesh = DecodeConfig(EncodeConfig(MakeConfig(Builder::kHybrid, Preset::kAuto)));
  ASSERT_TRUE(by_mesh.ok()) << by_mesh.status();
  EXPECT_EQ(by_mesh->preset, Preset::kAuto);
  EXPECT_EQ(by_mesh->delta, kDeltaByMesh);
}

TEST(RecordFileTest, ANameComesBack) {
  const absl::StatusOr<NameRecord> record = DecodeName(EncodeName({"Hase = \xC3\xA4", std::string(64, 'a')}));
  ASSERT_TRUE(record.ok()) << record.status();
  EXPECT_EQ(record->name, "Hase = \xC3\xA4");
  EXPECT_EQ(record->id, std::string(64, 'a'));
  // A name that looks like the last line.
  EXPECT_EQ(DecodeName(EncodeName({"sha256=1", std::string(64, 'a')}))->name, "sha256=1");
}

TEST(RecordFileTest, RefusesEveryTruncationAndEveryFlippedBit) {
  const std::string config = EncodeConfig(OddConfig());
  const std::string name = EncodeName({"bunny", std::string(64, 'b')});
  for (size_t i = 0; i < config.size(); ++i) EXPECT_FALSE(DecodeConfig(config.substr(0, i)).ok()) << i;
  for (size_t i = 0; i < name.size(); ++i) EXPECT_FALSE(DecodeName(name.substr(0, i)).ok()) << i;
  for (size_t bit = 0; bit < 8 * config.size(); ++bit) {
    std::string flipped = config;
    flipped[bit / 8] ^= static_cast<char>(1 << bit % 8);
    EXPECT_FALSE(DecodeConfig(flipped).ok()) << bit;
  }
  for (size_t bit = 0; bit < 8 * name.size(); ++bit) {
    std::string flipped = name;
    flipped[bit / 8] ^= static_cast<char>(1 << bit % 8);
    EXPECT_FALSE(DecodeName(flipped).ok()) << bit;
  }
  EXPECT_FALSE(DecodeConfig(config + "\n").ok());
  EXPECT_FALSE(DecodeName(config).ok());
  EXPECT_FALSE(DecodeConfig(name).ok());
}

TEST(RecordFileTest, RefusesWhatOnlyTheChecksumLikes) {
  const std::string id(64, 'c');
  EXPECT_TRUE(DecodeName(Sealed("deltaray name 1\nmesh=" + id + "\nname=x\n")).ok());
  EXPECT_FALSE(DecodeName(Sealed("deltaray name 1\nname=x\nmesh=" + id + "\n")).ok());
  EXPECT_FALSE(DecodeName(Sealed("deltaray name 1\nmesh=" + id + "\nname=x\nmore=1\n")).ok());
  EXPECT_FALSE(DecodeName(Sealed("deltaray name 1\nmesh=../../etc\nname=x\n")).ok());
  EXPECT_FALSE(DecodeName(Sealed("deltaray name 1\nmesh=" + id + "\nname=" + id + "\n")).ok());
  EXPECT_FALSE(DecodeName(Sealed("deltaray name 1\n")).ok());
  EXPECT_FALSE(DecodeName(Sealed("deltaray name one\nmesh=" + id + "\nname=x\n")).ok());

  Config config;
  config.delta = 5000;  // over its range
  EXPECT_THAT(DecodeConfig(EncodeConfig(config)).status().ToString(), HasSubstr("delta"));
}

TEST(RecordFileTest, SaysThatANewerDeltarayWroteIt) {
  const absl::Status status = DecodeName(Sealed("deltaray name 2\nwhatever\n")).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(status.ToString(), HasSubstr("version 2"));
}

}  // namespace
}  // namespace deltaray
