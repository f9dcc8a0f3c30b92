// The calls under way, so that the server can end without cutting off answers.

#ifndef SERVER_SERVICE_CALLS_H_
#define SERVER_SERVICE_CALLS_H_

#include <chrono>
#include <memory>
#include <unordered_map>

#include "absl/status/status.h"
#include "server/build/mutex.h"

namespace deltaray {

// One RPC under way.
class Call {
 public:
  virtual ~Call() = default;

  // The server drains. A call that has work of a client in hand finishes it; one that waits for its client, or would
  // take long, ends now with DrainingError(). Called at most once, on the thread that drains.
  virtual void OnDrain() {}
};

// What a call that the drain ends or refuses is told.
absl::Status DrainingError();

// All calls under way. Thread-safe.
class Calls {
 public:
  // Notes a call. False where the server drains already: the call must then end with DrainingError().
  bool Add(const std::shared_ptr<Call>& call);
  // Forgets a call that has ended; nothing happens where it is not known.
  void Remove(const Call* call);

  // Lets no call in any more, and tells those under way.
  void Drain();
  // Waits until no call is left. False where some are at the deadline.
  bool WaitUntilNone(std::chrono::steady_clock::time_point deadline);

 private:
  Mutex mutex_;
  Condition changed_;
  std::unordered_map<const Call*, std::weak_ptr<Call>> calls_ ABSL_GUARDED_BY(mutex_);
  bool draining_ ABSL_GUARDED_BY(mutex_) = false;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_CALLS_H_
