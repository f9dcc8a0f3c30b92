// What all reactors have in common: they own themselves, finish once, and know when they are cancelled.

#ifndef SERVER_SERVICE_CALL_REACTOR_H_
#define SERVER_SERVICE_CALL_REACTOR_H_

#include <atomic>
#include <memory>
#include <utility>

#include "absl/status/status.h"
#include "server/build/mutex.h"
#include "server/service/calls.h"
#include "server/service/log.h"
#include "server/service/rpc_status.h"

namespace deltaray {

// Base of a reactor; `Reactor` is one of gRPC's. It lives until gRPC is done with the call and no task holds it any
// more, so that a task may outlive the call: tasks hold a shared_ptr, and touch gRPC only under mutex_, while
// !finished_.
//
// All state that reactions share is guarded by mutex_, which is also held around gRPC's Start... and Finish: their
// reactions never run within them.
template <typename Reactor>
class CallReactor : public Reactor, public Call {
 public:
  explicit CallReactor(Calls* calls) : calls_(calls) {}

  // Whether the client has gone, or the answer is not wanted any more. Cheap.
  bool cancelled() const { return cancelled_.load(std::memory_order_relaxed); }

 protected:
  // Hands `call` over to gRPC. False: it is refused, and was finished.
  static bool Admit(const std::shared_ptr<CallReactor>& call, const RpcInfo& rpc) {
    call->self_ = call;
    const absl::Status status = call->calls_->Add(call, rpc);
    if (status.ok()) return true;
    MutexLock lock(call->mutex_);
    call->FinishOnce(status);
    return false;
  }

  // Finishes the call; nothing happens where it has finished already.
  void FinishOnce(const absl::Status& status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (finished_) return;
    finished_ = true;
    status_ = status;
    BeforeFinish();
    if (!status.ok()) cancelled_.store(true, std::memory_order_relaxed);
    const LogScope scope(record().request_id);
    this->Finish(ToRpcStatus(status));
  }

  // Marks the call as cancelled, so that its tasks end soon.
  void SetCancelled() { cancelled_.store(true, std::memory_order_relaxed); }

  void OnCancel() override {
    SetCancelled();
    MutexLock lock(mutex_);
    FinishOnce(absl::CancelledError("cancelled by the client"));
  }

  void OnDone() override {
    SetCancelled();
    absl::Status status;
    {
      MutexLock lock(mutex_);
      status = status_;
    }
    calls_->Remove(this, status);
    const std::shared_ptr<CallReactor> self = std::move(self_);
  }

  // The last moment to set trailing metadata.
  virtual void BeforeFinish() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {}

  Mutex mutex_;
  bool finished_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Status status_ ABSL_GUARDED_BY(mutex_);  // once finished_

 private:
  Calls* const calls_;
  std::atomic<bool> cancelled_{false};
  std::shared_ptr<CallReactor> self_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_CALL_REACTOR_H_
