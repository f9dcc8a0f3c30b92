#include <algorithm>
#include <functional>

#include "absl/strings/str_cat.h"
#include "tests/torture/history.h"

namespace deltaray {
namespace {

using Kind = Event::Kind;
using Outcome = Event::Outcome;

// Before `change` had its effect, another one cannot have come that was begun after its end.
bool EndsBefore(const Event& change, const Event& other) {
  return change.outcome == Outcome::kDone && change.end < other.begin;
}

// Whether an event of `kind` may have had an effect.
bool MayBe(const Event& event, Kind kind) { return event.kind == kind && event.outcome != Outcome::kNotFound; }
bool Sets(const Event& event, int name) {
  return event.name == name && (MayBe(event, Kind::kMove) || MayBe(event, Kind::kUpload));
}

class History {
 public:
  History(const std::vector<Event>& events, std::chrono::nanoseconds stale) : events_(events), stale_(stale.count()) {}

  bool MeshMayAnswer(const Event& ask) const {
    return Any([&](const Event& upload) {
      return MayBe(upload, Kind::kUpload) && upload.mesh == ask.mesh && upload.begin < ask.end &&
             !WasUndone(upload, ask,
                        [&](const Event& other) { return other.kind == Kind::kDelete && other.mesh == ask.mesh; });
    });
  }

  bool NameMayLeadToAnswer(const Event& ask) const {
    return Any([&](const Event& move) {
      return Sets(move, ask.name) && move.mesh == ask.mesh && move.begin < ask.end &&
             !WasUndone(move, ask, [&](const Event& other) {
               return (Sets(other, ask.name) && other.mesh != ask.mesh) ||
                      (other.kind == Kind::kDelete && other.mesh == ask.mesh);
             });
    });
  }

  bool MeshMayBeAbsent(const Event& ask) const {
    return !Any([&](const Event& upload) {
      return upload.kind == Kind::kUpload && upload.mesh == ask.mesh && StoodBefore(upload, ask) &&
             !MayBeDeletedSince(upload, ask, ask.mesh);
    });
  }

  bool NameMayBeAbsent(const Event& ask) const {
    return !Any([&](const Event& move) {
      return Sets(move, ask.name) && StoodBefore(move, ask) && !MayBeDeletedSince(move, ask, -1);
    });
  }

 private:
  template <typename Condition>
  bool Any(const Condition& condition) const {
    return std::any_of(events_.begin(), events_.end(), condition);
  }
  bool StoodBefore(const Event& change, const Event& ask) const {
    return change.outcome == Outcome::kDone && change.end < ask.begin - stale_;
  }
  // Whether something that `undoes` came surely after `change`, and surely before what `ask` may have seen.
  template <typename Undoes>
  bool WasUndone(const Event& change, const Event& ask, const Undoes& undoes) const {
    return Any(
        [&](const Event& other) { return undoes(other) && EndsBefore(change, other) && StoodBefore(other, ask); });
  }
  // `mesh`: -1 for any.
  bool MayBeDeletedSince(const Event& change, const Event& ask, int mesh) const {
    return Any([&](const Event& other) {
      return MayBe(other, Kind::kDelete) && (mesh < 0 || other.mesh == mesh) && !EndsBefore(other, change) &&
             other.begin < ask.end;
    });
  }

  const std::vector<Event>& events_;
  const int64_t stale_;
};

}  // namespace

std::vector<std::string> CheckHistory(const std::vector<Event>& events, std::chrono::nanoseconds stale) {
  const History history(events, stale);
  std::vector<std::string> wrong;
  for (const Event& ask : events) {
    if (ask.kind != Kind::kAsk || ask.outcome == Outcome::kUnknown) continue;
    const std::string when = absl::StrCat(" between ", ask.begin, " and ", ask.end);
    if (ask.outcome == Outcome::kNotFound) {
      if (ask.name < 0 && !history.MeshMayBeAbsent(ask)) {
        wrong.push_back(absl::StrCat("mesh ", ask.mesh, " was not found", when));
      }
      if (ask.name >= 0 && !history.NameMayBeAbsent(ask)) {
        wrong.push_back(absl::StrCat("name ", ask.name, " was not found", when));
      }
    } else if (!history.MeshMayAnswer(ask)) {
      wrong.push_back(absl::StrCat("mesh ", ask.mesh, " answered, which was deleted or not there yet,", when));
    } else if (ask.name >= 0 && !history.NameMayLeadToAnswer(ask)) {
      wrong.push_back(absl::StrCat("name ", ask.name, " led to mesh ", ask.mesh, ", to which it did not point,", when));
    }
  }
  return wrong;
}

}  // namespace deltaray
