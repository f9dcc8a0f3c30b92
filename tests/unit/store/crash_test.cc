// Kills a server, as kill -9 does, at any moment, and looks at what is left.

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <fstream>
#include <map>
#include <random>
#include <string>
#include <thread>

#include "server/store/sha256.h"
#include "spdlog/spdlog.h"
#include "tests/unit/store/fixture.h"

namespace deltaray {
namespace {

using ::testing::IsEmpty;

constexpr int kMeshes = 6;
constexpr int kRounds = 30;

// Environment of the child: its data directory, the file that it acknowledges to, and its seed.
constexpr char kDirectoryVariable[] = "DELTARAY_CRASH_DIRECTORY";
constexpr char kAcknowledgedVariable[] = "DELTARAY_CRASH_ACKNOWLEDGED";
constexpr char kSeedVariable[] = "DELTARAY_CRASH_SEED";

// Mesh `i` has the name `i` or none; the name "moving" is on any of them.
std::string Obj(int i) { return StripObj(i, 200); }

// What the child has begun and what was acknowledged: of each mesh whether it is there (+), not there (-) or in between
// (?), and of the moving name the number of its mesh, nothing where it is not there, or what begins with ? in between.
struct Known {
  std::map<int, char> meshes;
  std::string moving;
};

// Follows the lines "begin what mesh" and "done what mesh" that the child wrote. Returns how many things were done.
int Follow(const std::string& path, Known* known) {
  int count = 0;
  std::ifstream lines(path);
  std::string when, what;
  int mesh = 0;
  while (lines >> when >> what >> mesh) {
    const bool done = when == "done";
    count += done;
    if (what == "upload") known->meshes[mesh] = done ? '+' : known->meshes[mesh] == '+' ? '+' : '?';
    if (what == "delete") known->meshes[mesh] = done ? '-' : '?';
    if (what == "move") known->moving = done ? std::to_string(mesh) : "?";
    // A mesh takes its names with it.
    if (what == "delete" && !done && known->moving == std::to_string(mesh)) known->moving.insert(0, "?");
    if (what == "delete" && done && known->moving == "?" + std::to_string(mesh)) known->moving = "";
  }
  return count;
}

// The server that is killed; runs only as the child of the test below.
TEST(CrashTest, DISABLED_Child) {
  const char* directory = std::getenv(kDirectoryVariable);
  if (directory == nullptr) GTEST_SKIP() << "runs as a child of SurvivesKills";
  spdlog::set_level(spdlog::level::off);
  std::mt19937 random(static_cast<unsigned>(std::atoi(std::getenv(kSeedVariable))));
  const int acknowledged = open(std::getenv(kAcknowledgedVariable), O_WRONLY | O_APPEND | O_CREAT, 0600);
  const auto say = [&](const std::string& line) {
    ASSERT_EQ(write(acknowledged, (line + "\n").data(), line.size() + 1), static_cast<ssize_t>(line.size() + 1));
  };
  const auto store = OpenStore(directory);
  for (;;) {
    const int mesh = static_cast<int>(random() % kMeshes);
    const std::string name = std::to_string(mesh);
    switch (random() % 8) {
      case 0:
        say("begin delete " + name);
        if (absl::StatusCode code = store->Delete(name).status().code();
            code == absl::StatusCode::kOk || code == absl::StatusCode::kNotFound) {
          say("done delete " + name);
        }
        break;
      case 1:
        if (!store->Get(name).ok()) break;
        say("begin move " + name);
        ASSERT_TRUE(store->Name("moving", name).ok());
        say("done move " + name);
        break;
      case 2:
        if (Config config; store->Get(name).ok()) {
          config.delta = 1 + random() % 64;
          ASSERT_TRUE(store->Rebuild(name, config).ok());
        }
        break;
      case 3:
        ASSERT_TRUE((*store->StartUpload())->Append(Obj(mesh)).ok());
        break;
      default:
        say("begin upload " + name);
        ASSERT_TRUE(Put(*store, Obj(mesh), name).ok());
        say("done upload " + name);
    }
  }
}

// Starts this program again as the child above.
pid_t StartChild(const std::string& directory, const std::string& acknowledged, int seed) {
  setenv(kDirectoryVariable, directory.c_str(), 1);
  setenv(kAcknowledgedVariable, acknowledged.c_str(), 1);
  setenv(kSeedVariable, std::to_string(seed).c_str(), 1);
  std::string program = "/proc/self/exe", filter = "--gtest_filter=CrashTest.DISABLED_Child",
              disabled = "--gtest_also_run_disabled_tests";
  char* const arguments[] = {program.data(), filter.data(), disabled.data(), nullptr};
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, "/dev/null", O_WRONLY, 0);
  pid_t child = -1;
  EXPECT_EQ(posix_spawn(&child, program.c_str(), &actions, nullptr, arguments, environ), 0);
  posix_spawn_file_actions_destroy(&actions);
  return child;
}

TEST(CrashTest, SurvivesKills) {
  ScratchDirectory directory;
  const std::string data = directory.path() + "/data";
  std::mt19937 random(1);
  Known known;
  int done = 0;
  for (int round = 0; round < kRounds; ++round) {
    const std::string acknowledged = directory.path() + "/" + std::to_string(round);
    const pid_t child = StartChild(data, acknowledged, round);
    ASSERT_GT(child, 0);
    // From its first step on it has a time to live that ends anywhere in the next ones.
    for (int wait = 0; wait < 10000 && !std::filesystem::exists(acknowledged); ++wait) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    std::this_thread::sleep_for(std::chrono::microseconds(random() % 100'000));
    kill(child, SIGKILL);
    int status = 0;
    waitpid(child, &status, 0);
    ASSERT_TRUE(WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL) << "the child failed by itself";
    done += Follow(acknowledged, &known);

    const auto store = OpenStore(data);
    std::set<std::string> expected;
    for (int mesh = 0; mesh < kMeshes; ++mesh) {
      const std::string name = std::to_string(mesh);
      const char state = known.meshes[mesh];
      const auto info = store->Get(name);
      ASSERT_TRUE(info.ok() || state != '+') << "round " << round << " lost mesh " << name;
      ASSERT_TRUE(!info.ok() || state == '+' || state == '?') << "round " << round << " has the deleted mesh " << name;
      if (info.ok()) {
        const auto answer = AwaitTree(*store, name);
        ASSERT_TRUE(answer.ok()) << answer.status();
        EXPECT_EQ(HitStrip(*answer, mesh).t, 1);
      }
      known.meshes[mesh] = info.ok() ? '+' : '-';
    }
    const auto moving = store->Get("moving");
    if (known.moving.empty()) {
      EXPECT_FALSE(moving.ok()) << "round " << round;
    } else if (known.moving[0] != '?') {
      ASSERT_TRUE(moving.ok()) << "round " << round << " lost the name on " << known.moving;
      EXPECT_EQ(moving->id, store->Get(known.moving)->id);
    }
    known.moving = "";
    // No file is left that belongs to nothing. A mesh may have no name, where its upload was not acknowledged.
    for (const MeshInfo& info : store->List("", 100)) {
      expected.insert("meshes/" + info.id + ".mesh");
      if (std::filesystem::exists(data + "/configs/" + info.id + ".config")) {
        expected.insert("configs/" + info.id + ".config");
      }
      for (const std::string& name : info.names) {
        expected.insert("names/" + Sha256::Hex(name) + ".name");
        // A mesh of which the child was killed while it deleted it may have only this name left.
        if (name == "moving") known.moving = info.names.front() == name ? "?" : info.names.front();
      }
    }
    EXPECT_EQ(FilesIn(data), expected) << "round " << round;
  }
  // The child did get somewhere.
  EXPECT_GT(done, kRounds);
}

}  // namespace
}  // namespace deltaray
