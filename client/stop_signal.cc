#include "client/stop_signal.h"

#include <sys/eventfd.h>
#include <unistd.h>

#include <csignal>
#include <cstdint>
#include <thread>

namespace deltaray {

StopSignal::StopSignal() : fd_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {}

StopSignal::~StopSignal() { close(fd_); }

void StopSignal::Fire() {
  const std::lock_guard lock(mutex_);
  if (fired_.exchange(true, std::memory_order_acq_rel)) return;
  for (grpc::ClientContext* context : contexts_) context->TryCancel();
  const uint64_t one = 1;
  // The counter is 0 and cannot be full, so that the write cannot fail.
  [[maybe_unused]] const ssize_t written = write(fd_, &one, sizeof(one));
}

StopSignal::Scope::Scope(StopSignal& stop, grpc::ClientContext& context) : stop_(stop), context_(context) {
  const std::lock_guard lock(stop_.mutex_);
  stop_.contexts_.insert(&context_);
  if (stop_.fired()) context_.TryCancel();
}

StopSignal::Scope::~Scope() {
  const std::lock_guard lock(stop_.mutex_);
  stop_.contexts_.erase(&context_);
}

void StopOnSignals(StopSignal& stop) {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  std::thread([&stop, signals] {
    int signal = 0;
    sigwait(&signals, &signal);
    stop.Fire();
    // Unblocked here, with the default action, the next one ends the process.
    pthread_sigmask(SIG_UNBLOCK, &signals, nullptr);
    while (true) pause();
  }).detach();
}

}  // namespace deltaray
