// One call of Health.Watch.

#ifndef SERVER_SERVICE_HEALTH_WATCH_H_
#define SERVER_SERVICE_HEALTH_WATCH_H_

#include <memory>
#include <optional>
#include <string>

#include "grpcpp/alarm.h"
#include "grpcpp/support/byte_buffer.h"
#include "grpcpp/support/server_callback.h"
#include "server/service/call_reactor.h"
#include "server/service/health.h"

namespace deltaray {

// Tells the health of one service at once and whenever it has changed; looks at it every quarter of a second, at a
// mesh that is not known, or has a damaged file, every second.
class HealthWatch final : public CallReactor<grpc::ServerWriteReactor<grpc::ByteBuffer>> {
 public:
  // Takes over a call: the reactor to give to gRPC. Where `status` is not OK, the call ends with it. The call counts in
  // `watches` while it lives; what is pointed at outlives it.
  static grpc::ServerWriteReactor<grpc::ByteBuffer>* Start(Calls* calls, const RpcInfo& rpc, const Health* health,
                                                           WorkerPool* disk, const absl::Status& status,
                                                           std::string service, std::atomic<size_t>* watches);

  HealthWatch(Calls* calls, const Health* health, WorkerPool* disk, std::string service, std::atomic<size_t>* watches);
  ~HealthWatch() override { --*watches_; }

 private:
  void OnWriteDone(bool ok) override;
  void OnDrain() override;

  // Looks now, or as soon as a thread of the disk can, and again later.
  void Look() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void LookOnDisk() ABSL_LOCKS_EXCLUDED(mutex_);
  // Takes what was seen, and has it looked again later.
  void Take(Health::Status seen) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Writes the health where it is news, and ends the call once a drain was told.
  void Tell(Health::Status status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void TellDrain() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const Health* const health_;
  WorkerPool* const disk_;
  const std::string service_;
  std::atomic<size_t>* const watches_;
  std::weak_ptr<HealthWatch> weak_self_;

  grpc::ByteBuffer outgoing_;  // gRPC's while writing_
  bool writing_ ABSL_GUARDED_BY(mutex_) = false;
  bool draining_ ABSL_GUARDED_BY(mutex_) = false;
  std::optional<Health::Status> told_ ABSL_GUARDED_BY(mutex_);
  std::unique_ptr<grpc::Alarm> alarm_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_HEALTH_WATCH_H_
