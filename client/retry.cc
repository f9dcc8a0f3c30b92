#include "client/retry.h"

#include <algorithm>

#include "absl/strings/match.h"

namespace deltaray {
namespace {

using std::chrono::milliseconds;

// Waits grow twofold between these; each is halved by chance, so that clients of one lost server do not come together.
constexpr milliseconds kFirstWait{100};
constexpr milliseconds kLongestWait{2000};
constexpr int kDoublings = 5;

}  // namespace

bool IsLoss(const grpc::Status& status) {
  if (status.error_code() == grpc::StatusCode::UNAVAILABLE) return true;
  // What gRPC answers to calls that arrive while it shuts down.
  if (status.error_code() == grpc::StatusCode::CANCELLED) return true;
  // What gRPC makes of a stream that a proxy resets because the server behind it has died.
  return status.error_code() == grpc::StatusCode::INTERNAL &&
         absl::StartsWith(status.error_message(), "Received RST_STREAM");
}

bool Retry::Again(const grpc::Status& status) {
  const Session& session = connection_.session();
  if (!IsLoss(status) || session.retry_seconds <= 0 || session.stop.fired()) return false;
  const auto now = std::chrono::steady_clock::now();
  if (losses_ == 0) first_loss_ = now;
  const milliseconds longest = std::min(kLongestWait, kFirstWait * (1 << std::min(losses_, kDoublings)));
  ++losses_;
  const milliseconds wait(std::uniform_int_distribution<int64_t>(longest.count() / 2, longest.count())(random_));
  if (std::chrono::duration<double>(now + wait - first_loss_).count() > session.retry_seconds) return false;
  connection_.Wait(wait);
  return !session.stop.fired();
}

}  // namespace deltaray
