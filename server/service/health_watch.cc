#include "server/service/health_watch.h"

#include <chrono>
#include <utility>

#include "server/service/message_bytes.h"

namespace deltaray {
namespace {

using grpc::health::v1::HealthCheckResponse;

constexpr std::chrono::milliseconds kHealthInterval{250};
// What is not known is looked for on the disk.
constexpr std::chrono::milliseconds kUnknownInterval{1000};

}  // namespace

HealthWatch::HealthWatch(Calls* calls, const Health* health, WorkerPool* disk, std::string service,
                         std::atomic<size_t>* watches)
    : CallReactor(calls), health_(health), disk_(disk), service_(std::move(service)), watches_(watches) {
  ++*watches_;
}

grpc::ServerWriteReactor<grpc::ByteBuffer>* HealthWatch::Start(Calls* calls, const RpcInfo& rpc, const Health* health,
                                                               WorkerPool* disk, const absl::Status& status,
                                                               std::string service, std::atomic<size_t>* watches) {
  auto call = std::make_shared<HealthWatch>(calls, health, disk, std::move(service), watches);
  call->weak_self_ = call;
  if (!Admit(call, rpc)) return call.get();
  MutexLock lock(call->mutex_);
  if (status.ok()) {
    call->Look();
  } else {
    call->FinishOnce(status);
  }
  return call.get();
}

void HealthWatch::Look() {
  if (finished_) return;
  const absl::Status status = CatchExceptions([&]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
    if (health_->FindBlocks(service_)) {
      const auto self = weak_self_.lock();
      disk_->Run([self] { self->LookOnDisk(); }, [self] { return self->cancelled(); });
    } else {
      Take(health_->Of(service_));
    }
    return absl::OkStatus();
  });
  if (!status.ok()) FinishOnce(status);
}

void HealthWatch::LookOnDisk() {
  // Without the lock, which the call's reactions and the ticker take.
  Health::Status seen = HealthCheckResponse::UNKNOWN;
  const absl::Status status = CatchExceptions([&] {
    seen = health_->Find(service_);
    return absl::OkStatus();
  });
  MutexLock lock(mutex_);
  if (status.ok()) {
    Take(seen);
  } else {
    FinishOnce(status);
  }
}

void HealthWatch::Take(Health::Status seen) {
  Tell(seen);
  if (finished_) return;
  // As in WatchCall: an alarm cannot be set anew from within its own callback.
  const auto interval = health_->FindBlocks(service_) ? kUnknownInterval : kHealthInterval;
  alarm_ = std::make_unique<grpc::Alarm>();
  alarm_->Set(std::chrono::system_clock::now() + interval, [weak_self = weak_self_](bool) {
    const std::shared_ptr<HealthWatch> self = weak_self.lock();
    if (self == nullptr) return;
    MutexLock lock(self->mutex_);
    self->Look();
  });
}

void HealthWatch::Tell(Health::Status status) {
  if (writing_ || finished_) return;
  if (status != told_) {
    told_ = status;
    HealthCheckResponse response;
    response.set_status(status);
    outgoing_ = SerializeMessage(response);
    writing_ = true;
    StartWrite(&outgoing_);
  } else if (draining_) {
    FinishOnce(DrainingError());
  }
}

void HealthWatch::OnWriteDone(bool ok) {
  MutexLock lock(mutex_);
  writing_ = false;
  if (!ok) FinishOnce(absl::CancelledError("the client has gone"));
  if (draining_) TellDrain();
}

void HealthWatch::OnDrain() {
  MutexLock lock(mutex_);
  draining_ = true;
  TellDrain();
}

void HealthWatch::TellDrain() {
  // One that is still looked for on the disk may be there, but does not serve either.
  Tell(told_ == HealthCheckResponse::SERVICE_UNKNOWN ? HealthCheckResponse::SERVICE_UNKNOWN
                                                     : HealthCheckResponse::NOT_SERVING);
}

}  // namespace deltaray
