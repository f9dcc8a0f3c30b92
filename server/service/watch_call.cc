#include "server/service/watch_call.h"

#include <chrono>
#include <utility>

#include "google/protobuf/util/message_differencer.h"
#include "server/service/mesh_messages.h"
#include "server/service/message_bytes.h"

namespace deltaray {
namespace {
constexpr std::chrono::milliseconds kWatchInterval{100};
}  // namespace

grpc::ServerWriteReactor<grpc::ByteBuffer>* WatchCall::Start(Calls* calls, const RpcInfo& rpc, MeshStore* store,
                                                             WorkerPool* disk, const grpc::ByteBuffer* request) {
  auto call = std::make_shared<WatchCall>(calls, store, disk);
  call->weak_self_ = call;
  if (Admit(call, rpc)) {
    MutexLock lock(call->mutex_);
    const absl::Status status =
        CatchExceptions([&]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return call->ReadRequest(*request); });
    if (status.ok()) {
      call->Look();
    } else {
      call->FinishOnce(status);
    }
  }
  return call.get();
}

absl::Status WatchCall::ReadRequest(const grpc::ByteBuffer& request) {
  v1::WatchBuildRequest message;
  if (absl::Status status = ParseSmallMessage(request, &message); !status.ok()) return status;
  mesh_ = message.mesh();
  return absl::OkStatus();
}

void WatchCall::Look() {
  if (finished_) return;
  const absl::Status status = CatchExceptions([&]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
    if (const absl::StatusOr<std::string> id = store_->ResolveKnown(mesh_); id.ok()) {
      LookAt(id);
    } else {
      const auto self = weak_self_.lock();
      disk_->Run([self] { self->LookOnDisk(); }, [self] { return self->cancelled(); });
    }
    return absl::OkStatus();
  });
  if (!status.ok()) FinishOnce(status);
}

void WatchCall::LookOnDisk() {
  std::string mesh;
  {
    MutexLock lock(mutex_);
    mesh = mesh_;
  }
  // Without the lock, which the call's reactions and the ticker take.
  absl::StatusOr<std::string> id;
  const absl::Status status = CatchExceptions([&] {
    id = store_->Resolve(mesh);
    return id.status();
  });
  MutexLock lock(mutex_);
  LookAt(status.ok() ? id : status);
}

void WatchCall::LookAt(const absl::StatusOr<std::string>& id) {
  if (finished_) return;
  const absl::Status status = CatchExceptions([&]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
    if (!id.ok()) return id.status();
    mesh_ = *id;
    return Report();
  });
  if (!status.ok()) FinishOnce(status);
  if (finished_) return;
  // An alarm cannot be set anew from within its own callback, which it keeps: held by that, the call would never die.
  alarm_ = std::make_unique<grpc::Alarm>();
  alarm_->Set(std::chrono::system_clock::now() + kWatchInterval, [weak_self = weak_self_](bool) {
    const std::shared_ptr<WatchCall> self = weak_self.lock();
    if (self == nullptr) return;
    MutexLock lock(self->mutex_);
    self->Look();
  });
}

absl::Status WatchCall::Report() {
  // Once: of meshes that do not fit into memory together, those who watch them would have each other's built again and
  // again.
  absl::StatusOr<BuildReport> report = store_->Watch(mesh_, /*start=*/!reported_);
  if (!report.ok()) return report.status();
  if (writing_) return absl::OkStatus();

  v1::WatchBuildResponse response;
  response.set_id(mesh_);
  *response.mutable_progress() = ToMessage(*report);
  v1::BuildProgress progress = response.progress();
  progress.clear_elapsed_seconds();
  const bool changed = !reported_ || !google::protobuf::util::MessageDifferencer::Equals(progress, last_);
  const bool over = IsOver(*report);
  if (!changed && !over) return absl::OkStatus();
  if (!changed) {
    FinishOnce(absl::OkStatus());
    return absl::OkStatus();
  }

  last_ = std::move(progress);
  reported_ = true;
  outgoing_ = SerializeMessage(response);
  if (over) {
    BeginFinish(absl::OkStatus());
    StartWriteAndFinish(&outgoing_, grpc::WriteOptions(), grpc::Status::OK);
  } else {
    writing_ = true;
    StartWrite(&outgoing_);
  }
  return absl::OkStatus();
}

bool WatchCall::IsOver(const BuildReport& report) {
  if (report.state == MeshState::kProvisional) return report.progress.lazy;
  // Where it is only stored, it has made room for others.
  return report.state != MeshState::kBuilding;
}

void WatchCall::OnWriteDone(bool ok) {
  MutexLock lock(mutex_);
  writing_ = false;
  if (!ok) FinishOnce(absl::CancelledError("the client has gone"));
  if (draining_) FinishOnce(DrainingError());
}

void WatchCall::OnDrain() {
  MutexLock lock(mutex_);
  draining_ = true;
  if (!writing_) FinishOnce(DrainingError());
}

}  // namespace deltaray
