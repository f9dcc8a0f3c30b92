#include "tests/torture/crash.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <map>
#include <random>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/store/sha256.h"
#include "tests/eventually.h"
#include "tests/torture/fleet.h"
#include "tests/torture/subject.h"

namespace deltaray {
namespace {

constexpr int kWriters = 3;
constexpr int kMeshesEach = 2;
constexpr uint32_t kRaysOfSubject = 64;
// How long a server may take to notice what was done through another one, on a busy machine.
constexpr std::chrono::seconds kNotice{10};

enum class State { kAbsent, kPresent, kUnknown };

// What one client knows of its meshes and of its name, which nobody else changes.
struct Ledger {
  std::map<const Subject*, State> meshes;
  std::string name;
  std::set<std::string> targets;  // ids that the name may point at; "": it is not there
};

struct CrashCounts {
  std::atomic<int> uploads{0}, moves{0}, deletes{0}, rebuilds{0}, answers{0}, unacknowledged{0}, failures{0};
};

class CrashTorture {
 public:
  explicit CrashTorture(const CrashOptions& options)
      : options_(options),
        subjects_(kWriters * kMeshesEach, kRaysOfSubject),
        fleet_(options.servers, options.binary, options.directory),
        random_(options.seed) {
    for (int i = 0; i < kWriters; ++i) {
      Ledger ledger{{}, absl::StrCat("name", i), {""}};
      for (int k = 0; k < kMeshesEach; ++k) ledger.meshes[subjects_.meshes[i * kMeshesEach + k].get()] = State::kAbsent;
      ledgers_.push_back(std::move(ledger));
    }
  }

  bool Run() {
    const auto begin = std::chrono::steady_clock::now();
    int kills = 0;
    for (round_ = 0; round_ < options_.rounds && counts_.failures == 0; ++round_) {
      if (const absl::Status status = fleet_.Start(); !status.ok()) Fail(status.ToString());
      if (round_ > 0) Verify();
      if (counts_.failures == 0) kills += RunClients();
    }
    if (const absl::Status status = fleet_.Start(); !status.ok()) Fail(status.ToString());
    if (counts_.failures == 0) Verify();
    if (const absl::Status status = fleet_.Stop(); !status.ok()) Fail(status.ToString());
    // Where nothing was acknowledged, nothing was lost either.
    if (counts_.uploads == 0 || counts_.answers == 0) Fail("no upload or no answer was acknowledged");
    std::printf(
        "crash: %d servers, %d rounds, %d kills in %.0f s, seed %llu: %d uploads, %d moves, %d deletes, %d rebuilds "
        "and %d answers acknowledged, %d calls not; %d lost\n",
        options_.servers, round_, kills,
        std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count(),
        static_cast<unsigned long long>(options_.seed), counts_.uploads.load(), counts_.moves.load(),
        counts_.deletes.load(), counts_.rebuilds.load(), counts_.answers.load(), counts_.unacknowledged.load(),
        counts_.failures.load());
    return counts_.failures == 0;
  }

 private:
  void Fail(const std::string& what) {
    ++counts_.failures;
    std::printf("FAILED in round %d: %s\n", round_, what.c_str());
  }

  // Lets the clients work until some of the servers were killed. Returns how many.
  int RunClients() {
    std::atomic<bool> stop{false};
    std::vector<std::thread> clients;
    for (int i = 0; i < kWriters; ++i) {
      clients.emplace_back([this, &stop, i, seed = random_()] { Work(ledgers_[i], seed, stop); });
    }
    std::this_thread::sleep_for(std::chrono::microseconds(5'000 + random_() % 400'000));
    const uint64_t chosen = random_();
    int kills = 0;
    for (int i = 0; i < fleet_.size(); ++i) {
      if (i != static_cast<int>(chosen % fleet_.size()) && (chosen >> (8 + i)) % 2 == 0) continue;
      if (const absl::Status status = fleet_.Kill(i); !status.ok()) Fail(status.ToString());
      ++kills;
    }
    stop = true;
    for (std::thread& client : clients) client.join();
    return kills;
  }

  void Work(Ledger& ledger, uint64_t seed, const std::atomic<bool>& stop) {
    std::mt19937_64 random(seed);
    FleetClient client(fleet_);
    while (!stop) {
      const absl::StatusOr<Connection*> connection = client.To(static_cast<int>(random() % fleet_.size()));
      if (!connection.ok()) continue;  // killed
      auto mesh = ledger.meshes.begin();
      std::advance(mesh, random() % kMeshesEach);
      if (const absl::Status status = Step(**connection, ledger, *mesh->first, mesh->second, random()); !status.ok()) {
        ++counts_.unacknowledged;
      }
    }
  }

  // One call. Before it the ledger tells what may come of it, after it what has.
  absl::Status Step(Connection& connection, Ledger& ledger, const Subject& subject, State& state, uint64_t choice) {
    const State before = state;
    switch (choice % 8) {
      case 0:
      case 1: {
        const bool named = choice / 8 % 2 == 0;
        if (state == State::kAbsent) state = State::kUnknown;
        if (named) ledger.targets.insert(subject.id);
        const auto id = UploadArrays(
            connection, subject.mesh, [] {}, named ? ledger.name : "");
        if (!id.ok()) return id.status();
        if (*id != subject.id) Fail(absl::StrCat("mesh ", subject.id, " was stored as ", *id));
        state = State::kPresent;
        if (named) ledger.targets = {subject.id};
        ++counts_.uploads;
        return absl::OkStatus();
      }
      case 2: {
        state = State::kUnknown;
        if (ledger.targets.count(subject.id) != 0) ledger.targets.insert("");
        const absl::Status status = DeleteMesh(connection, subject.id);
        if (absl::IsNotFound(status) && before == State::kPresent) Fail("a delete did not find mesh " + subject.id);
        if (!status.ok() && !absl::IsNotFound(status)) return status;
        state = State::kAbsent;
        ledger.targets.erase(subject.id);
        if (ledger.targets.empty()) ledger.targets = {""};
        ++counts_.deletes;
        return absl::OkStatus();
      }
      case 3: {
        if (state != State::kPresent) return absl::OkStatus();
        ledger.targets.insert(subject.id);
        if (absl::Status status = NameMesh(connection, ledger.name, subject.id); !status.ok()) {
          if (absl::IsNotFound(status)) Fail("a name could not be given to mesh " + subject.id);
          return status;
        }
        ledger.targets = {subject.id};
        ++counts_.moves;
        return absl::OkStatus();
      }
      case 4: {
        if (state != State::kPresent) return absl::OkStatus();
        if (absl::Status status = RebuildMesh(connection, subject.id, 1 + choice / 8 % 64); !status.ok()) {
          if (absl::IsNotFound(status)) Fail("a rebuild did not find mesh " + subject.id);
          return status;
        }
        ++counts_.rebuilds;
        return absl::OkStatus();
      }
      default:
        return Ask(connection, subject, state == State::kPresent, choice / 8 % 2 == 0);
    }
  }

  absl::Status Ask(Connection& connection, const Subject& subject, bool must_be_there, bool wait_final) {
    const auto reply = Cast(connection, subject.id, subjects_.rays, 0, kRaysOfSubject,
                            wait_final ? v1::BUILD_WAIT_FINAL : v1::BUILD_WAIT_PROVISIONAL);
    if (!reply.ok()) {
      if (absl::IsNotFound(reply.status()) && !must_be_there) return absl::OkStatus();
      if (absl::IsNotFound(reply.status())) Fail("rays did not find mesh " + subject.id);
      if (absl::IsDataLoss(reply.status()) || absl::IsFailedPrecondition(reply.status())) {
        Fail(reply.status().ToString());
      }
      return reply.status();
    }
    if (!subject.Accepts(reply->hits(), 0)) Fail("wrong answers from mesh " + subject.id);
    ++counts_.answers;
    return absl::OkStatus();
  }

  static bool Soon(const std::function<bool()>& holds) { return Eventually(holds, kNotice); }

  // Nothing is under way. Every server must have what is acknowledged, and all the same of what is not.
  void Verify() {
    FleetClient client(fleet_);
    std::vector<Connection*> servers;
    for (int i = 0; i < fleet_.size(); ++i) {
      const absl::StatusOr<Connection*> connection = client.To(i);
      if (!connection.ok()) return Fail(connection.status().ToString());
      servers.push_back(*connection);
    }
    for (Ledger& ledger : ledgers_) {
      for (auto& [subject, state] : ledger.meshes) VerifyMesh(servers, *subject, state);
      VerifyName(servers, ledger);
    }
    VerifyFiles(*servers[0]);
  }

  void VerifyMesh(const std::vector<Connection*>& servers, const Subject& subject, State& state) {
    if (state == State::kUnknown) {
      // A server that was started again has nothing but what is on disk; one that lives on may have what was deleted
      // through another one a moment ago.
      const std::string file = absl::StrCat(fleet_.data_directory(), "/meshes/", subject.id, ".mesh");
      state = std::filesystem::exists(file) ? State::kPresent : State::kAbsent;
    }
    for (size_t i = 0; i < servers.size(); ++i) {
      if (state == State::kPresent) {
        const absl::Status status = Ask(*servers[i], subject, true, true);
        if (!status.ok()) Fail(absl::StrCat("server ", i, " has lost mesh ", subject.id, ": ", status.ToString()));
      } else if (!Soon([&] { return absl::IsNotFound(GetMesh(*servers[i], subject.id).status()); })) {
        Fail(absl::StrCat("server ", i, " still has the deleted mesh ", subject.id));
      }
    }
  }

  void VerifyName(const std::vector<Connection*>& servers, Ledger& ledger) {
    // The first server that agrees with the ledger and with all others tells.
    std::string seen;
    const bool agree = Soon([&] {
      std::set<std::string> found;
      for (Connection* const server : servers) {
        const absl::StatusOr<v1::Mesh> mesh = GetMesh(*server, ledger.name);
        found.insert(mesh.ok() ? mesh->id() : absl::IsNotFound(mesh.status()) ? "" : mesh.status().ToString());
      }
      seen = absl::StrCat(found.size() == 1 ? "" : "different meshes, one of them ", *found.rbegin());
      return found.size() == 1 && ledger.targets.count(seen) != 0;
    });
    if (!agree) {
      std::string targets;
      for (const std::string& target : ledger.targets) absl::StrAppend(&targets, " [", target, "]");
      return Fail(absl::StrCat(ledger.name, " leads to [", seen, "], not to", targets));
    }
    ledger.targets = {seen};
  }

  void VerifyFiles(Connection& server) {
    std::set<std::string> expected, found;
    absl::Status listed;
    const bool same = Soon([&] {
      const auto meshes = ListMeshes(server);
      listed = meshes.status();
      if (!listed.ok()) return false;
      expected.clear(), found.clear();
      for (const v1::Mesh& mesh : *meshes) {
        expected.insert(absl::StrCat("meshes/", mesh.id(), ".mesh"));
        const std::string config = absl::StrCat("configs/", mesh.id(), ".config");
        if (std::filesystem::exists(absl::StrCat(fleet_.data_directory(), "/", config))) expected.insert(config);
        for (const std::string& name : mesh.names())
          expected.insert(absl::StrCat("names/", Sha256::Hex(name), ".name"));
      }
      for (const auto& entry : std::filesystem::recursive_directory_iterator(fleet_.data_directory())) {
        if (!entry.is_regular_file() || entry.path().filename() == "lock") continue;
        found.insert(std::filesystem::relative(entry.path(), fleet_.data_directory()).string());
      }
      return found == expected;
    });
    if (same) return;
    if (!listed.ok()) return Fail("the meshes were not listed: " + listed.ToString());
    for (const std::string& file : found) {
      if (expected.count(file) == 0) Fail("a stray file: " + file);
    }
    for (const std::string& file : expected) {
      if (found.count(file) == 0) Fail("a missing file: " + file);
    }
  }

  const CrashOptions options_;
  const Subjects subjects_;
  Fleet fleet_;
  std::mt19937_64 random_;
  std::vector<Ledger> ledgers_;
  CrashCounts counts_;
  int round_ = 0;
};

}  // namespace

bool TortureByCrashes(const CrashOptions& options) { return CrashTorture(options).Run(); }

}  // namespace deltaray
