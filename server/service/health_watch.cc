#include "server/service/health_watch.h"

#include <chrono>
#include <utility>

#include "server/service/message_bytes.h"

namespace deltaray {
namespace {
constexpr std::chrono::milliseconds kHealthInterval{250};
// What is not known may be looked for on the disk.
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
      disk_->Run([self = weak_self_.lock()] { self->LookOnDisk(); });
    } else {
      Take(health_->Of(service_));
    }
    return absl::OkStatus();
  });
  if (!status.ok()) FinishOnce(status);
}

void HealthWatch::LookOnDisk() {
  if (cancelled()) return;
  // Without the lock, which the call's reactions and the ticker take.
  Health::Status seen = grpc::health::v1::HealthCheckResponse::UNKNOWN;
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
  const bool unknown = told_ == grpc::health::v1::HealthCheckResponse::SERVICE_UNKNOWN;
  alarm_ = std::make_unique<grpc::Alarm>();
  alarm_->Set(std::chrono::system_clock::now() + (unknown ? kUnknownInterval : kHealthInterval),
              [weak_self = weak_self_](bool) {
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
    grpc::health::v1::HealthCheckResponse response;
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
  if (draining_) Tell(health_->Of(service_));
}

void HealthWatch::OnDrain() {
  MutexLock lock(mutex_);
  draining_ = true;
  Tell(health_->Of(service_));
}

}  // namespace deltaray
