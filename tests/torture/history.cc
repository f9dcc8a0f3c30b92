#include "tests/torture/history.h"

#include <signal.h>

#include <atomic>
#include <cstdio>
#include <random>
#include <thread>

#include "absl/strings/str_cat.h"
#include "client/exit_code.h"
#include "tests/torture/fleet.h"
#include "tests/torture/subject.h"

namespace deltaray {
namespace {

constexpr int kClients = 6;
constexpr int kMeshes = 6;
constexpr int kNames = 3;
constexpr uint32_t kRays = 256;
constexpr size_t kBatch = 32;  // rays of a call, or of a batch of a stream
// Where there are several servers, each notices what others have done within a second. One that was stopped while it
// looked looks again only after ten times that: within three, and on a machine as busy as this within five.
constexpr std::chrono::seconds kStale{5};
constexpr std::chrono::milliseconds kLongestStop{300};
// How much longer it goes on while nothing has come through, as on a very busy machine.
constexpr std::chrono::seconds kPatience{60};

struct HistoryCounts {
  std::atomic<uint64_t> uploads{0}, answers{0}, batches{0}, cut{0}, failures{0};
  int kills = 0, stops = 0;

  // Where nothing comes through, nothing is wrong either.
  bool Tell() const { return uploads > 0 && answers > 0 && batches > 0; }
};

class HistoryTorture {
 public:
  explicit HistoryTorture(const HistoryOptions& options)
      : options_(options),
        subjects_(kMeshes, kRays),
        fleet_(options.servers, options.binary, options.directory),
        events_(kClients) {}

  bool Run() {
    if (const absl::Status status = fleet_.Start(); !status.ok()) Fail(status.ToString());
    std::mt19937_64 random(options_.seed);
    std::vector<std::thread> clients;
    for (int i = 0; i < kClients; ++i) {
      clients.emplace_back([this, i, seed = random()] { Work(&events_[i], seed); });
    }
    Disturb(random);
    stop_ = true;
    for (std::thread& client : clients) client.join();
    if (const absl::Status status = fleet_.Stop(); !status.ok()) Fail(status.ToString());

    std::vector<Event> history;
    for (const auto& events : events_) history.insert(history.end(), events.begin(), events.end());
    uint64_t unknown = 0;
    for (const Event& event : history) unknown += event.outcome == Event::Outcome::kUnknown;
    if (!counts_.Tell()) {
      Fail(absl::StrCat("no more than ", counts_.uploads.load(), " uploads, ", counts_.answers.load(), " answers and ",
                        counts_.batches.load(), " batches"));
    }
    const auto stale = options_.servers > 1 ? kStale : std::chrono::seconds(0);
    for (const std::string& wrong : CheckHistory(history, stale)) Fail(wrong);
    std::printf(
        "history: %d servers, %.0f s, seed %llu: %zu calls, %llu of them unacknowledged, %llu answers and %llu batches "
        "of "
        "streams, %d kills, %d stops, %llu connections cut; %llu wrong\n",
        options_.servers, options_.seconds, static_cast<unsigned long long>(options_.seed), history.size(),
        static_cast<unsigned long long>(unknown), static_cast<unsigned long long>(counts_.answers.load()),
        static_cast<unsigned long long>(counts_.batches.load()), counts_.kills, counts_.stops,
        static_cast<unsigned long long>(counts_.cut.load()), static_cast<unsigned long long>(counts_.failures.load()));
    return counts_.failures == 0;
  }

 private:
  static int64_t Now() { return std::chrono::steady_clock::now().time_since_epoch() / std::chrono::nanoseconds(1); }

  void Fail(const std::string& what) {
    if (++counts_.failures <= 20) std::printf("FAILED: %s\n", what.c_str());
  }

  // Kills and stops servers until the time is up, and something has come through; then all of them run.
  void Disturb(std::mt19937_64& random) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(options_.seconds);
    while (counts_.failures == 0) {
      const auto now = std::chrono::steady_clock::now();
      if (now >= end && (counts_.Tell() || now >= end + kPatience)) break;
      std::this_thread::sleep_for(std::chrono::milliseconds(100 + random() % 900));
      const int server = static_cast<int>(random() % fleet_.size());
      if (random() % 2 == 0) {
        if (const absl::Status status = fleet_.Kill(server); !status.ok()) Fail(status.ToString());
        ++counts_.kills;
        std::this_thread::sleep_for(std::chrono::milliseconds(random() % 200));
        if (const absl::Status status = fleet_.Start(); !status.ok()) Fail(status.ToString());
      } else {
        fleet_.Signal(server, SIGSTOP);
        ++counts_.stops;
        std::this_thread::sleep_for(kLongestStop * (random() % 100) / 100);
        fleet_.Signal(server, SIGCONT);
      }
    }
  }

  void Work(std::vector<Event>* events, uint64_t seed) {
    std::mt19937_64 random(seed);
    FleetClient client(fleet_);
    while (!stop_) {
      const int server = static_cast<int>(random() % fleet_.size());
      const absl::StatusOr<Connection*> connection = client.To(server);
      if (!connection.ok()) {
        std::this_thread::sleep_for(std::chrono::milliseconds(5));
        continue;
      }
      Event event;
      event.mesh = static_cast<int>(random() % kMeshes);
      event.name = random() % 2 == 0 ? static_cast<int>(random() % kNames) : -1;
      event.begin = Now();
      const absl::Status status = Step(**connection, random, &event);
      event.end = Now();
      event.outcome = status.ok() || absl::IsAborted(status) ? Event::Outcome::kDone
                      : absl::IsNotFound(status)             ? Event::Outcome::kNotFound
                                                             : Event::Outcome::kUnknown;
      if (absl::IsDataLoss(status) || absl::IsFailedPrecondition(status)) Fail(status.ToString());
      if (absl::IsAborted(status)) ++counts_.cut;
      if (status.ok() && event.kind == Event::Kind::kUpload) ++counts_.uploads;
      if (!status.ok()) client.Drop(server);
      events->push_back(event);
    }
  }

  // ABORTED: the client has cut the connection after some batches were answered.
  absl::Status Step(Connection& connection, std::mt19937_64& random, Event* event) {
    const Subject& subject = *subjects_.meshes[event->mesh];
    switch (random() % 16) {
      case 0:
      case 1:
      case 2:
        event->kind = Event::Kind::kUpload;
        return UploadArrays(
                   connection, subject.mesh, [] {}, event->name < 0 ? "" : NameOf(event->name))
            .status();
      case 3:
      case 4:
        event->kind = Event::Kind::kMove;
        event->name = static_cast<int>(random() % kNames);
        return NameMesh(connection, NameOf(event->name), subject.id);
      case 5:
        event->kind = Event::Kind::kDelete;
        event->name = -1;
        return DeleteMesh(connection, subject.id);
      case 6:
      case 7:
      case 8:
        return Stream(connection, random, event);
      default:
        return Ask(connection, random, event);
    }
  }

  static std::string NameOf(int name) { return absl::StrCat("name", name); }
  std::string Target(const Event& ask) const {
    return ask.name < 0 ? subjects_.meshes[ask.mesh]->id : NameOf(ask.name);
  }

  // The mesh whose answers these are, of those that may be; -1: none.
  int Recognise(const v1::HitBatch& hits, size_t first, int expected) const {
    for (int i = 0; i < kMeshes; ++i) {
      if ((expected < 0 || i == expected) && subjects_.meshes[i]->Accepts(hits, first)) return i;
    }
    return -1;
  }

  absl::Status Ask(Connection& connection, std::mt19937_64& random, Event* event) {
    const size_t first = random() % (kRays - kBatch);
    const auto reply = Cast(connection, Target(*event), subjects_.rays, first, kBatch,
                            random() % 2 == 0 ? v1::BUILD_WAIT_FINAL : v1::BUILD_WAIT_PROVISIONAL);
    if (!reply.ok()) return reply.status();
    const int mesh = Recognise(reply->hits(), first, event->name < 0 ? event->mesh : -1);
    if (mesh < 0 || reply->mesh_id() != subjects_.meshes[mesh]->id) {
      Fail(absl::StrCat("wrong answers from ", Target(*event), ", mesh ", reply->mesh_id()));
    }
    event->mesh = mesh;
    ++counts_.answers;
    return absl::OkStatus();
  }

  absl::Status Stream(Connection& connection, std::mt19937_64& random, Event* event) {
    // Some are cut in the middle.
    const uint64_t cut_after = random() % 32;
    uint64_t batches = 0;
    int mesh = event->name < 0 ? event->mesh : -1;
    const absl::Status status = StreamAll(
        connection, Target(*event), subjects_.rays, 0, kRays, kBatch, [&](size_t first, const v1::HitBatch& hits) {
          mesh = Recognise(hits, first, mesh);
          if (mesh < 0) {
            Fail(absl::StrCat("wrong answers from ", Target(*event), " in batch ", batches));
            return absl::AbortedError("wrong answers");
          }
          ++counts_.batches;
          return ++batches == cut_after ? absl::AbortedError("cut") : absl::OkStatus();
        });
    if (status.ok() && batches * kBatch != kRays) Fail(absl::StrCat("a stream ended well after ", batches, " batches"));
    // What the client's own checks of numbers and counts found.
    if (ExitCode(status) == kExitLocalFailure && !absl::IsAborted(status)) Fail(status.ToString());
    if (batches == 0) return status;
    // Batches that came before an error are answers too.
    event->mesh = mesh;
    return absl::IsAborted(status) ? status : absl::OkStatus();
  }

  const HistoryOptions options_;
  const Subjects subjects_;
  Fleet fleet_;
  std::atomic<bool> stop_{false};
  std::vector<std::vector<Event>> events_;  // by client
  HistoryCounts counts_;
};

}  // namespace

bool TortureByHistory(const HistoryOptions& options) { return HistoryTorture(options).Run(); }

}  // namespace deltaray
