// What all reactors have in common: they own themselves, finish once, and know when they are cancelled.

#ifndef SERVER_SERVICE_CALL_REACTOR_H_
#define SERVER_SERVICE_CALL_REACTOR_H_

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <utility>

#include "absl/status/status.h"
#include "grpc/grpc.h"
#include "grpcpp/server_context.h"
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
    {
      MutexLock lock(call->mutex_);
      call->context_ = rpc.context;
      call->active_at_ = rpc.began;
    }
    const absl::Status status = call->calls_->Add(call, rpc);
    if (status.ok()) return true;
    MutexLock lock(call->mutex_);
    call->FinishOnce(status);
    return false;
  }

  // Finishes the call; nothing happens where it has finished already.
  void FinishOnce(const absl::Status& status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (finished_) return;
    BeginFinish(status);
    const LogScope scope(record().request_id);
    this->Finish(ToRpcStatus(status));
  }

  // Comes once, before whatever finishes the call.
  void BeginFinish(const absl::Status& status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    finished_ = true;
    NoteActivity();
    status_ = status;
    BeforeFinish();
    if (!status.ok()) cancelled_.store(true, std::memory_order_relaxed);
    calls_->NoteAnswer(this);
  }

  // Ends the call at once, although its client does not take what was sent to it, which Finish would wait for.
  void CutOff(const absl::Status& status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (done_) return;
    FinishOnce(status);
    // That it was finished with another one, nobody learns.
    status_ = status;
    const grpc::Status rpc_status = ToRpcStatus(status);
    grpc_call_cancel_with_status(context_->c_call(), static_cast<grpc_status_code>(rpc_status.error_code()),
                                 rpc_status.error_message().c_str(), nullptr);
  }

  // Cuts off a call that still lives, from any thread that holds no call's lock: for BatchBudget::Share::Reply.
  static std::function<void()> CutOffLater(std::weak_ptr<CallReactor> weak_call, absl::Status status) {
    return [weak_call = std::move(weak_call), status = std::move(status)] {
      const auto call = weak_call.lock();
      if (call == nullptr) return;
      MutexLock lock(call->mutex_);
      call->CutOff(status);
    };
  }

  // What the client has not done, where the call waits for its client; nullptr where it does not.
  virtual const char* MissingFromClient() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) { return nullptr; }

  // To be called whenever the client, or the server for it, has done something.
  void NoteActivity() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) { active_at_ = std::chrono::steady_clock::now(); }

  void OnTick(std::chrono::steady_clock::time_point idle_since) override {
    MutexLock lock(mutex_);
    if (active_at_ > idle_since) return;
    if (finished_) {
      CutOff(status_.ok() ? calls_->IdleError("not taken the reply") : status_);
    } else if (const char* missing = MissingFromClient(); missing != nullptr) {
      CutOff(calls_->IdleError(missing));
    }
  }

  // Marks the call as cancelled, so that its tasks end soon.
  void SetCancelled() { cancelled_.store(true, std::memory_order_relaxed); }

  void OnCancel() override {
    SetCancelled();
    MutexLock lock(mutex_);
    // gRPC cancels calls whose deadline has passed, and those that the server cuts off, too.
    const bool late = context_->deadline() <= std::chrono::system_clock::now();
    FinishOnce(late                ? absl::DeadlineExceededError("the deadline of the call has passed")
               : calls_->cut_off() ? CutOffError()
                                   : absl::CancelledError("cancelled by the client"));
  }

  void OnDone() override {
    SetCancelled();
    absl::Status status;
    {
      MutexLock lock(mutex_);
      status = status_;
      done_ = true;
    }
    calls_->Remove(this, status);
    const std::shared_ptr<CallReactor> self = std::move(self_);
  }

  // The last moment to set trailing metadata.
  virtual void BeforeFinish() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {}

  Mutex mutex_;
  grpc::CallbackServerContext* context_ ABSL_GUARDED_BY(mutex_) = nullptr;  // gRPC's; valid while !done_
  bool done_ ABSL_GUARDED_BY(mutex_) = false;                               // gRPC is done with the call
  std::chrono::steady_clock::time_point active_at_ ABSL_GUARDED_BY(mutex_);
  bool finished_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Status status_ ABSL_GUARDED_BY(mutex_);  // once finished_

 private:
  Calls* const calls_;
  std::atomic<bool> cancelled_{false};
  std::shared_ptr<CallReactor> self_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_CALL_REACTOR_H_
