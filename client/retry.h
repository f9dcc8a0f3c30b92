// When to ask again, and how long to wait before.

#ifndef CLIENT_RETRY_H_
#define CLIENT_RETRY_H_

#include <chrono>
#include <random>

#include "client/connection.h"
#include "grpcpp/support/status.h"

namespace deltaray {

// Whether an RPC that ended like this ended because the server, or the way to it, was lost: the same call may succeed
// at another server, or at this one once it is back. Where the program is stopped, its own calls end like this, too.
bool IsLoss(const grpc::Status& status);

// The tries of one thing to do. They end retry_seconds after the first loss since the last success.
class Retry {
 public:
  // The connection must outlive this.
  explicit Retry(const Connection& connection) : connection_(connection) {}

  // A try got an answer.
  void Succeeded() { losses_ = 0; }
  // A try ended with `status`. True: it is to be made again, and the time to wait before has passed. False: the status
  // stands, as it is no loss, the time is up, or the program is stopped.
  bool Again(const grpc::Status& status);

 private:
  const Connection& connection_;
  int losses_ = 0;  // since the last success
  std::chrono::steady_clock::time_point first_loss_;
  std::minstd_rand random_{std::random_device{}()};
};

}  // namespace deltaray

#endif  // CLIENT_RETRY_H_
