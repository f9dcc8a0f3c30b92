// Everything at once, on few meshes, so that all meet; above all for the thread sanitizer.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "spdlog/spdlog.h"
#include "tests/unit/store/fixture.h"

namespace deltaray {
namespace {

TEST(ConcurrencyTest, UploadsMovesDeletesRebuildsAndQueriesDoNotDisturbEachOther) {
  constexpr int kMeshes = 3;
  constexpr int kThreads = 4;
  constexpr int kSteps = 60;
  ScratchDirectory directory;
  MeshStore::Options options;
  options.concurrent_builds = 2;
  auto store = OpenStore(directory.path(), options);
  std::vector<std::string> ids;
  for (int i = 0; i < kMeshes; ++i) ids.push_back(Put(*store, StripObj(i, 50))->info.id);

  std::atomic<int> answers{0}, asked{0}, hits{0};
  const auto work = [&](unsigned seed) {
    std::mt19937 random(seed);
    for (int step = 0; step < kSteps; ++step) {
      const int mesh = static_cast<int>(random() % kMeshes);
      const std::string name = "name" + std::to_string(random() % 2);
      switch (random() % 8) {
        case 0:
          EXPECT_TRUE(Put(*store, StripObj(mesh, 50), name).ok());
          break;
        case 1:
          store->Name(name, ids[mesh]).IgnoreError();
          break;
        case 2:
          store->Delete(ids[mesh]).IgnoreError();
          break;
        case 3:
          store->Rebuild(ids[mesh], {}).IgnoreError();
          break;
        case 4:
          for (const MeshInfo& info : store->List("", 10)) EXPECT_EQ(info.triangle_count, 100u);
          store->Statistics(ids[mesh]).IgnoreError();
          store->Watch(ids[mesh]).IgnoreError();
          break;
        default:
          ++asked;
          store->WithTree(ids[mesh], random() % 2 == 0, [&, mesh](absl::StatusOr<MeshStore::Answer> answer) {
            ++answers;
            if (!answer.ok()) {
              EXPECT_EQ(answer.status().code(), absl::StatusCode::kNotFound) << answer.status();
              return;
            }
            ++hits;
            EXPECT_EQ(answer->id, ids[mesh]);
            EXPECT_EQ(HitStrip(*answer, mesh).t, 1);
            store->NoteAnswer(*answer);
          });
      }
    }
  };
  std::vector<std::thread> threads;
  for (int i = 0; i < kThreads; ++i) threads.emplace_back(work, i);
  for (std::thread& thread : threads) thread.join();
  for (const std::string& id : ids) AwaitTree(*store, id).IgnoreError();
  EXPECT_EQ(answers, asked);
  EXPECT_GT(hits, 0);

  // Disk and memory agree.
  const std::vector<MeshInfo> before = store->List("", 10);
  store.reset();
  store = OpenStore(directory.path());
  const std::vector<MeshInfo> after = store->List("", 10);
  ASSERT_EQ(before.size(), after.size());
  for (size_t i = 0; i < before.size(); ++i) {
    EXPECT_EQ(before[i].id, after[i].id);
    EXPECT_EQ(before[i].names, after[i].names);
  }
}

TEST(ConcurrencyTest, OfUploadsOfTheSameMeshOneCreatesIt) {
  ScratchDirectory directory;
  const auto store = OpenStore(directory.path());
  std::atomic<int> created{0};
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i) {
    threads.emplace_back([&, i] {
      const auto put = Put(*store, StripObj(1, 500), "name" + std::to_string(i));
      ASSERT_TRUE(put.ok()) << put.status();
      created += put->created;
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(created, 1);
  ASSERT_EQ(store->List("", 10).size(), 1u);
  EXPECT_EQ(store->List("", 10)[0].names.size(), 4u);
  EXPECT_EQ(FilesIn(directory.path()).size(), 5u);
}

}  // namespace
}  // namespace deltaray
