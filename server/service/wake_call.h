// Keeps the threads of gRPC awake.

#ifndef SERVER_SERVICE_WAKE_CALL_H_
#define SERVER_SERVICE_WAKE_CALL_H_

#include <chrono>
#include <memory>
#include <utility>

#include "grpcpp/channel.h"
#include "server/build/mutex.h"

namespace deltaray {

// In gRPC 1.51 a thread that serves calls and has had nothing to do for a second sleeps for 100 ms. All of them do so
// at once where the server is idle, and a call that came then was answered that much later. A health check of
// ourselves, through memory, is something to do for one of them, which is awake for the next second. Thread-safe.
class WakeCall {
 public:
  explicit WakeCall(std::shared_ptr<grpc::Channel> channel) : channel_(std::move(channel)) {}
  // Cancels the call under way and waits for its end.
  ~WakeCall();

  // Makes the call, unless the one before is still under way; does not wait for it. To be called at least twice a
  // second.
  void Make();
  // How long the call under way has been waiting for its answer; 0: none is.
  std::chrono::milliseconds Waiting() const;

 private:
  struct Call;
  struct State {
    Mutex mutex;
    Condition changed;
    std::weak_ptr<Call> call ABSL_GUARDED_BY(mutex);
    bool under_way ABSL_GUARDED_BY(mutex) = false;  // until all of the call is gone
    std::chrono::steady_clock::time_point began ABSL_GUARDED_BY(mutex);
  };

  // Its last holder must not be a call, which gRPC lets go of on a thread that the channel's end would end.
  const std::shared_ptr<grpc::Channel> channel_;
  const std::shared_ptr<State> state_ = std::make_shared<State>();
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_WAKE_CALL_H_
