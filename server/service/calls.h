// The calls under way, so that the server can end without cutting off answers.

#ifndef SERVER_SERVICE_CALLS_H_
#define SERVER_SERVICE_CALLS_H_

#include <atomic>
#include <chrono>
#include <memory>
#include <unordered_map>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "server/build/mutex.h"
#include "server/service/call_watcher.h"

namespace deltaray {

// One RPC under way.
class Call {
 public:
  virtual ~Call() = default;

  // The server drains. A call that has work of a client in hand finishes it; one that waits for its client, or would
  // take long, ends now with DrainingError(). Called at most once, on the thread that drains.
  virtual void OnDrain() {}

  // Comes several times a second. A call that has waited for its client since `idle_since` or longer ends with
  // IdleError(). Must not take long.
  virtual void OnTick(std::chrono::steady_clock::time_point /*idle_since*/) {}

  CallRecord& record() { return record_; }

 private:
  CallRecord record_;
};

// What a call that the drain ends or refuses is told, and one that it cuts off.
absl::Status DrainingError();
absl::Status CutOffError();

// All calls under way. Thread-safe.
class Calls {
 public:
  // `watchers` are asked in this order, and outlive the calls. Calls that wait for their client longer than
  // `idle_timeout` end.
  explicit Calls(std::vector<CallWatcher*> watchers = {},
                 std::chrono::milliseconds idle_timeout = std::chrono::hours(1))
      : watchers_(std::move(watchers)), idle_timeout_(idle_timeout) {}

  // Notes a call. Where not OK, because a watcher refuses it or the server drains, the call must end with this status.
  absl::Status Add(const std::shared_ptr<Call>& call, RpcInfo rpc);
  // To be called once for each call, before it is answered.
  void NoteAnswer(const Call* call);
  // Forgets a call that has ended, with `status`.
  void Remove(const Call* call, const absl::Status& status);

  // To be called several times a second: ends idle calls.
  void Tick(std::chrono::steady_clock::time_point now);

  // What a call that waits for its client for too long is told: "the client has <done nothing> for ...".
  absl::Status IdleError(absl::string_view what) const;

  // Lets no call in any more, and tells those under way.
  void Drain();
  // Waits until no call is left. False where some are at the deadline: they are to be cut off.
  bool WaitUntilNone(std::chrono::steady_clock::time_point deadline);
  // Whether calls are being cut off.
  bool cut_off() const { return cut_off_.load(std::memory_order_relaxed); }

 private:
  struct UnderWay {
    std::weak_ptr<Call> call;
    RpcInfo rpc;
    size_t watched = 0;  // by so many of the watchers
  };

  // The calls that have not been destroyed yet.
  std::vector<std::shared_ptr<Call>> Alive() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const std::vector<CallWatcher*> watchers_;
  const std::chrono::milliseconds idle_timeout_;
  Mutex mutex_;
  Condition changed_;
  std::atomic<bool> cut_off_{false};
  std::unordered_map<const Call*, UnderWay> calls_ ABSL_GUARDED_BY(mutex_);
  bool draining_ ABSL_GUARDED_BY(mutex_) = false;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_CALLS_H_
