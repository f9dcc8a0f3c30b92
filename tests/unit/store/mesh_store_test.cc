#include "server/store/mesh_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <thread>

#include "server/store/sha256.h"
#include "tests/unit/store/fixture.h"

namespace deltaray {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

Config ConfigWithDelta(uint32_t delta) {
  Config config;
  config.delta = delta;
  return config;
}

TEST(MeshStoreTest, AnUploadIsThereWithAllThatIsKnownOfIt) {
  ScratchDirectory directory;
  const auto store = OpenStore(directory.path());
  const auto put = Put(*store, StripObj(7), "strip");
  ASSERT_TRUE(put.ok()) << put.status();
  EXPECT_TRUE(put->created);
  EXPECT_EQ(put->info.vertex_count, 6u);
  EXPECT_EQ(put->info.triangle_count, 4u);
  EXPECT_EQ(put->info.face_count, 2u);
  EXPECT_EQ(put->info.report.bounds.max, (Vec3f{2, 1, 7}));
  EXPECT_THAT(put->info.groups, ElementsAre("strip"));
  EXPECT_THAT(put->info.names, ElementsAre("strip"));

  const std::string file = directory.path() + "/meshes/" + put->info.id + ".mesh";
  EXPECT_EQ(put->info.stored_bytes, std::filesystem::file_size(file));
  EXPECT_THAT(FilesIn(directory.path()),
              ElementsAre("meshes/" + put->info.id + ".mesh", "names/" + Sha256::Hex("strip") + ".name"));

  const auto answer = AwaitTree(*store, "strip");
  ASSERT_TRUE(answer.ok()) << answer.status();
  EXPECT_EQ(answer->id, put->info.id);
  EXPECT_TRUE(answer->snapshot->final);
  EXPECT_EQ(HitStrip(*answer, 7).t, 1);
  EXPECT_EQ(store->Get("strip")->state, MeshState::kReady);
}

TEST(MeshStoreTest, EverythingIsThereAgainAfterReopening) {
  ScratchDirectory directory;
  MeshInfo before;
  {
    const auto store = OpenStore(directory.path());
    ASSERT_TRUE(Put(*store, StripObj(1), "one", ConfigWithDelta(5)).ok());
    ASSERT_TRUE(Put(*store, StripObj(2), "two").ok());
    ASSERT_TRUE(store->Name("uno", "one").ok());
    before = *store->Get("one");
  }
  const auto store = OpenStore(directory.path());
  const auto after = store->Get("uno");
  ASSERT_TRUE(after.ok());
  EXPECT_EQ(after->id, before.id);
  EXPECT_THAT(after->names, ElementsAre("one", "uno"));
  EXPECT_EQ(after->vertex_count, before.vertex_count);
  EXPECT_EQ(after->triangle_count, before.triangle_count);
  EXPECT_EQ(after->face_count, before.face_count);
  EXPECT_EQ(after->origin, before.origin);
  EXPECT_EQ(after->report.bounds, before.report.bounds);
  EXPECT_EQ(after->groups, before.groups);
  EXPECT_EQ(after->created, before.created);
  EXPECT_EQ(after->stored_bytes, before.stored_bytes);
  EXPECT_EQ(after->config.delta, 5u);
  EXPECT_EQ(after->state, MeshState::kStored);
  EXPECT_EQ(store->Get("two")->config.delta, Config().delta);
  EXPECT_EQ(store->List("", 10).size(), 2u);

  const auto answer = AwaitTree(*store, "one");
  ASSERT_TRUE(answer.ok()) << answer.status();
  EXPECT_EQ(HitStrip(*answer, 1).t, 1);
}

TEST(MeshStoreTest, NothingIsBuiltBeforeItIsAskedFor) {
  ScratchDirectory directory;
  {
    const auto store = OpenStore(directory.path());
    ASSERT_TRUE(Put(*store, StripObj(1), "one").ok());
    ASSERT_TRUE(Put(*store, StripObj(2), "two").ok());
  }
  const auto store = OpenStore(directory.path());
  EXPECT_EQ(store->Get("one")->state, MeshState::kStored);
  EXPECT_EQ(store->Statistics("one").status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(store->Watch("one")->build_number, 1u);
  ASSERT_TRUE(AwaitTree(*store, "one").ok());
  EXPECT_EQ(store->Watch("one")->build_number, 1u);
  EXPECT_EQ(store->Get("two")->state, MeshState::kStored);
}

}  // namespace
}  // namespace deltaray
