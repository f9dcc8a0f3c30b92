#include "server/service/ticker.h"

#include <utility>

namespace deltaray {

Ticker::Ticker(std::chrono::milliseconds interval, std::function<void()> tick) : state_(std::make_shared<State>()) {
  state_->interval = interval;
  state_->tick = std::move(tick);
  MutexLock lock(state_->mutex);
  SetAlarm(state_);
}

Ticker::~Ticker() {
  std::unique_ptr<grpc::Alarm> alarm, last_alarm;
  MutexLock lock(state_->mutex);
  state_->stopped = true;
  alarm = std::move(state_->alarm);
  last_alarm = std::move(state_->last_alarm);
}

void Ticker::SetAlarm(const std::shared_ptr<State>& state) {
  state->last_alarm = std::exchange(state->alarm, std::make_unique<grpc::Alarm>());
  state->alarm->Set(std::chrono::system_clock::now() + state->interval,
                    [weak_state = std::weak_ptr<State>(state)](bool) {
                      const std::shared_ptr<State> state = weak_state.lock();
                      if (state == nullptr) return;
                      MutexLock lock(state->mutex);
                      if (state->stopped) return;
                      state->tick();
                      SetAlarm(state);
                    });
}

}  // namespace deltaray
