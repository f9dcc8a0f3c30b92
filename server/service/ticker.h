// What has to be looked at every now and then.

#ifndef SERVER_SERVICE_TICKER_H_
#define SERVER_SERVICE_TICKER_H_

#include <chrono>
#include <functional>
#include <memory>

#include "grpcpp/alarm.h"
#include "server/build/mutex.h"

namespace deltaray {

// Calls a function every so often, on a thread of gRPC's that serves no calls, until it is destroyed.
class Ticker {
 public:
  // `tick` must not block or throw.
  Ticker(std::chrono::milliseconds interval, std::function<void()> tick);
  // Waits for a tick that is under way.
  ~Ticker();

 private:
  struct State {
    std::chrono::milliseconds interval;
    std::function<void()> tick;
    Mutex mutex;
    bool stopped ABSL_GUARDED_BY(mutex) = false;
    // The one that is set, and the one before, which cannot be destroyed within its own callback.
    std::unique_ptr<grpc::Alarm> alarm ABSL_GUARDED_BY(mutex), last_alarm ABSL_GUARDED_BY(mutex);
  };

  static void SetAlarm(const std::shared_ptr<State>& state) ABSL_EXCLUSIVE_LOCKS_REQUIRED(state->mutex);

  const std::shared_ptr<State> state_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_TICKER_H_
