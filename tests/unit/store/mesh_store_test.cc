#include "server/store/mesh_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <thread>

#include "server/build/mutex.h"
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

TEST(MeshStoreTest, UsageAndEndsOfBuildsAreTold) {
  ScratchDirectory directory;
  Mutex mutex;
  std::vector<EndedBuild> ended;
  {
    MeshStore::Options options;
    options.on_build_end = [&](const EndedBuild& build) {
      MutexLock lock(mutex);
      ended.push_back(build);
    };
    const auto store = OpenStore(directory.path(), std::move(options));
    const auto put = Put(*store, StripObj(1), "one");
    ASSERT_TRUE(put.ok()) << put.status();
    const auto answer = AwaitTree(*store, "one");
    ASSERT_TRUE(answer.ok()) << answer.status();
    const StoreUsage usage = store->Usage();
    EXPECT_THAT(usage.meshes, ElementsAre(0, 0, 0, 1, 0));
    EXPECT_EQ(usage.disk_bytes, put->info.stored_bytes);
    EXPECT_EQ(usage.mesh_bytes, answer->snapshot->mesh->Bytes());
    EXPECT_GT(usage.tree_bytes, 0u);
    EXPECT_EQ(usage.builds_waiting, 0u);
  }
  ASSERT_EQ(ended.size(), 1u);
  EXPECT_TRUE(ended[0].status.ok());
  EXPECT_GT(ended[0].seconds, 0);
  EXPECT_FALSE(ended[0].phases.empty());
  EXPECT_EQ(ended[0].delta_leaves_built, 1u);
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
  EXPECT_EQ(store->Watch("one", /*start=*/false)->state, MeshState::kStored);
  EXPECT_EQ(store->Watch("one")->build_number, 1u);
  ASSERT_TRUE(AwaitTree(*store, "one").ok());
  EXPECT_EQ(store->Watch("one")->build_number, 1u);
  EXPECT_EQ(store->Get("two")->state, MeshState::kStored);
}

TEST(MeshStoreTest, TheSameGeometryIsOneMesh) {
  ScratchDirectory directory;
  const auto store = OpenStore(directory.path());
  const auto first = Put(*store, StripObj(1), "a");
  const auto second = Put(*store, "# a comment\n" + StripObj(1), "b");
  ASSERT_TRUE(second.ok()) << second.status();
  EXPECT_FALSE(second->created);
  EXPECT_EQ(second->info.id, first->info.id);
  EXPECT_EQ(second->info.created, first->info.created);
  EXPECT_THAT(second->info.names, ElementsAre("a", "b"));
  ASSERT_TRUE(AwaitTree(*store, "a").ok());
  EXPECT_EQ(store->Watch("a")->build_number, 1u);
}

TEST(MeshStoreTest, UploadingAgainRebuildsOnlyForAnotherConfig) {
  ScratchDirectory directory;
  const auto store = OpenStore(directory.path());
  ASSERT_TRUE(Put(*store, StripObj(1), "a", ConfigWithDelta(5)).ok());
  ASSERT_TRUE(AwaitTree(*store, "a").ok());
  EXPECT_EQ(Put(*store, StripObj(1), "", ConfigWithDelta(5))->info.config.delta, 5u);
  EXPECT_EQ(Put(*store, StripObj(1))->info.config.delta, 5u);
  EXPECT_EQ(store->Watch("a")->build_number, 1u);
  EXPECT_EQ(Put(*store, StripObj(1), "", ConfigWithDelta(6))->info.config.delta, 6u);
  EXPECT_EQ(store->Watch("a")->build_number, 2u);
}

TEST(MeshStoreTest, UploadsAreCheckedAgainstWhatWasAnnounced) {
  ScratchDirectory directory;
  const auto store = OpenStore(directory.path());
  const auto commit = [&](Upload::CommitOptions options) {
    auto upload = *store->StartUpload();
    EXPECT_TRUE(upload->Append(StripObj(1)).ok());
    return upload->Commit(std::move(options)).status();
  };
  Upload::CommitOptions options;
  options.size = 5;
  EXPECT_THAT(commit(options).ToString(), HasSubstr("5 bytes were announced"));
  options = {};
  options.sha256 = std::string(32, 'x');
  EXPECT_THAT(commit(options).ToString(), HasSubstr("sha256"));
  options = {};
  options.name = "a\nb";
  EXPECT_THAT(commit(options).ToString(), HasSubstr("name"));
  options = {};
  options.config = ConfigWithDelta(0);
  EXPECT_THAT(commit(options).ToString(), HasSubstr("delta"));
  options = {};
  options.read.cancelled = [] { return true; };
  EXPECT_EQ(commit(options).code(), absl::StatusCode::kCancelled);
  // Also where it is cancelled when the mesh's file is written already.
  options.read.cancelled = [&] { return !FilesIn(directory.path()).empty(); };
  EXPECT_EQ(commit(options).code(), absl::StatusCode::kCancelled);
  options = {};
  options.read.format = MeshFormat::kRaw;  // of another size
  EXPECT_EQ(commit(options).code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(FilesIn(directory.path()), IsEmpty());
  EXPECT_THAT(store->List("", 10), IsEmpty());

  options = {};
  options.size = StripObj(1).size();
  Sha256 sha256;
  sha256.Update(StripObj(1));
  options.sha256 = sha256.Finish();
  EXPECT_TRUE(commit(options).ok());
}

TEST(MeshStoreTest, LimitsHoldForUploads) {
  ScratchDirectory directory;
  MeshStore::Options options;
  options.mesh_limits.max_triangles = 3;
  options.max_upload_bytes = 1000;
  const auto store = OpenStore(directory.path(), options);
  EXPECT_EQ(Put(*store, StripObj(1)).status().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_TRUE(Put(*store, StripObj(1, 1)).ok());
  EXPECT_EQ(Put(*store, std::string(1001, '#')).status().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(FilesIn(directory.path()).size(), 1u);
}

TEST(MeshStoreTest, AnUploadThatIsDroppedLeavesNothing) {
  ScratchDirectory directory;
  const auto store = OpenStore(directory.path());
  {
    auto upload = *store->StartUpload();
    ASSERT_TRUE(upload->Append(StripObj(1)).ok());
  }
  EXPECT_THAT(FilesIn(directory.path()), IsEmpty());
}

TEST(MeshStoreTest, NamesMove) {
  ScratchDirectory directory;
  std::string one, two;
  {
    const auto store = OpenStore(directory.path());
    one = Put(*store, StripObj(1), "a")->info.id;
    two = Put(*store, StripObj(2), "b")->info.id;
    EXPECT_EQ(*store->Name("a", "b"), one);
    EXPECT_EQ(store->Get("a")->id, two);
    EXPECT_THAT(store->Get(one)->names, IsEmpty());
    EXPECT_THAT(store->Get(two)->names, ElementsAre("a", "b"));
    EXPECT_EQ(*store->Name("a", two), two);
    EXPECT_EQ(*store->Name("c", one), "");
    EXPECT_EQ(*store->Name("b", ""), two);
    EXPECT_EQ(store->Get("b").status().code(), absl::StatusCode::kNotFound);

    EXPECT_EQ(store->Name("b", "").status().code(), absl::StatusCode::kNotFound);
    EXPECT_EQ(store->Name("a", "nobody").status().code(), absl::StatusCode::kNotFound);
    EXPECT_EQ(store->Name("a\n", one).status().code(), absl::StatusCode::kInvalidArgument);
    EXPECT_EQ(store->Name(one, two).status().code(), absl::StatusCode::kInvalidArgument);
    EXPECT_EQ(store->Get("a\n").status().code(), absl::StatusCode::kNotFound);
    EXPECT_EQ(store->Get("").status(), absl::NotFoundError("mesh: is empty; it must be a mesh id or a name"));
    // A name never becomes a path.
    EXPECT_EQ(*store->Name("../../escape", one), "");
  }
  EXPECT_FALSE(std::filesystem::exists(directory.path() + "/../escape"));
  const auto store = OpenStore(directory.path());
  EXPECT_THAT(store->Get(one)->names, ElementsAre("../../escape", "c"));
  EXPECT_THAT(store->Get(two)->names, ElementsAre("a"));
}

TEST(MeshStoreTest, DeletingLeavesNoFile) {
  ScratchDirectory directory;
  const auto store = OpenStore(directory.path());
  const std::string id = Put(*store, StripObj(1), "a", ConfigWithDelta(5))->info.id;
  ASSERT_TRUE(store->Name("b", "a").ok());
  EXPECT_EQ(FilesIn(directory.path()).size(), 4u);
  EXPECT_EQ(*store->Delete("b"), id);
  EXPECT_THAT(FilesIn(directory.path()), IsEmpty());
  for (const std::string& mesh : {std::string("a"), std::string("b"), id}) {
    EXPECT_EQ(store->Get(mesh).status().code(), absl::StatusCode::kNotFound);
    EXPECT_EQ(store->Delete(mesh).status().code(), absl::StatusCode::kNotFound);
    EXPECT_EQ(store->Watch(mesh).status().code(), absl::StatusCode::kNotFound);
    EXPECT_EQ(store->Rebuild(mesh, {}).status().code(), absl::StatusCode::kNotFound);
    EXPECT_EQ(AwaitTree(*store, mesh).status().code(), absl::StatusCode::kNotFound);
  }
  // Uploaded again it is a new mesh, with the default config.
  const auto again = Put(*store, StripObj(1));
  EXPECT_TRUE(again->created);
  EXPECT_EQ(again->info.config.delta, Config().delta);
}

TEST(MeshStoreTest, ATreeInUseOutlivesItsMesh) {
  ScratchDirectory directory;
  auto store = OpenStore(directory.path());
  ASSERT_TRUE(Put(*store, StripObj(3), "a").ok());
  const auto answer = AwaitTree(*store, "a");
  ASSERT_TRUE(store->Delete("a").ok());
  EXPECT_EQ(HitStrip(*answer, 3).t, 1);
  store->NoteAnswer(*answer);
  store.reset();
  EXPECT_EQ(HitStrip(*answer, 3).t, 1);
}

TEST(MeshStoreTest, ListsPageByPageInOrderOfId) {
  ScratchDirectory directory;
  const auto store = OpenStore(directory.path());
  std::set<std::string> ids;
  for (int i = 0; i < 5; ++i) ids.insert(Put(*store, StripObj(i))->info.id);
  std::vector<std::string> listed;
  for (std::string after;;) {
    const std::vector<MeshInfo> page = store->List(after, 2);
    if (page.empty()) break;
    EXPECT_LE(page.size(), 2u);
    for (const MeshInfo& info : page) {
      EXPECT_THAT(info.groups, IsEmpty());
      listed.push_back(info.id);
    }
    after = page.back().id;
  }
  EXPECT_EQ(listed, std::vector<std::string>(ids.begin(), ids.end()));
}

TEST(MeshStoreTest, StatisticsTellTheFirstAnswer) {
  ScratchDirectory directory;
  const auto store = OpenStore(directory.path());
  ASSERT_TRUE(Put(*store, StripObj(1), "a").ok());
  const auto answer = AwaitTree(*store, "a");
  EXPECT_EQ(store->Statistics("a")->first_answer_seconds, 0);
  store->NoteAnswer(*answer);
  const auto statistics = store->Statistics("a");
  ASSERT_TRUE(statistics.ok()) << statistics.status();
  const double first = statistics->first_answer_seconds;
  EXPECT_GT(first, 0);
  EXPECT_EQ(statistics->build_number, 1u);
  EXPECT_EQ(statistics->statistics.triangles, 4u);
  EXPECT_GE(statistics->mesh_bytes, 6 * sizeof(Vec3f) + 4 * 12);
  store->NoteAnswer(*answer);
  EXPECT_EQ(store->Statistics("a")->first_answer_seconds, first);
}

TEST(MeshStoreTest, RebuildTakesTheNewConfigAndKeepsIt) {
  ScratchDirectory directory;
  {
    const auto store = OpenStore(directory.path());
    ASSERT_TRUE(Put(*store, StripObj(1), "a").ok());
    ASSERT_TRUE(AwaitTree(*store, "a").ok());
    EXPECT_EQ(store->Rebuild("a", ConfigWithDelta(0)).status().code(), absl::StatusCode::kInvalidArgument);
    const auto info = store->Rebuild("a", ConfigWithDelta(9));
    ASSERT_TRUE(info.ok()) << info.status();
    EXPECT_EQ(info->config.delta, 9u);
    EXPECT_EQ(store->Watch("a")->build_number, 2u);
    // A tree answers all the time.
    const auto answer = AwaitTree(*store, "a");
    ASSERT_TRUE(answer.ok()) << answer.status();
    EXPECT_EQ(HitStrip(*answer, 1).t, 1);
    while (store->Get("a")->state != MeshState::kReady) std::this_thread::yield();
  }
  const auto store = OpenStore(directory.path());
  EXPECT_EQ(store->Get("a")->config.delta, 9u);
}

}  // namespace
}  // namespace deltaray
