// One switch that ends whatever a command is doing: RPCs are cancelled, reads from files and pipes return.

#ifndef CLIENT_STOP_SIGNAL_H_
#define CLIENT_STOP_SIGNAL_H_

#include <atomic>
#include <mutex>
#include <set>

#include "grpcpp/client_context.h"

namespace deltaray {

// Thread-safe. Once fired it stays fired.
class StopSignal {
 public:
  StopSignal();
  ~StopSignal();
  StopSignal(const StopSignal&) = delete;
  StopSignal& operator=(const StopSignal&) = delete;

  // Cancels all RPCs in scope and those that come later, and makes fd() readable.
  void Fire();

  bool fired() const { return fired_.load(std::memory_order_acquire); }

  // A file descriptor that polls as readable once fired.
  int fd() const { return fd_; }

  // Makes Fire() cancel the RPC of a context, from construction to destruction. The context must outlive this.
  class Scope {
   public:
    Scope(StopSignal& stop, grpc::ClientContext& context);
    ~Scope();
    Scope(const Scope&) = delete;
    Scope& operator=(const Scope&) = delete;

   private:
    StopSignal& stop_;
    grpc::ClientContext& context_;
  };

 private:
  std::atomic<bool> fired_ = false;
  int fd_;
  std::mutex mutex_;
  std::set<grpc::ClientContext*> contexts_;  // guarded by mutex_
};

// Fires `stop` at the first SIGINT or SIGTERM; the second one ends the process at once. Call it before any other thread
// exists: threads inherit that these signals are blocked. `stop` must live as long as the process.
void StopOnSignals(StopSignal& stop);

}  // namespace deltaray

#endif  // CLIENT_STOP_SIGNAL_H_
