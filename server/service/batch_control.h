// What a batch asks of its surroundings while it is worked on.

#ifndef SERVER_SERVICE_BATCH_CONTROL_H_
#define SERVER_SERVICE_BATCH_CONTROL_H_

#include <functional>

namespace deltaray {

// Both are called from any of the threads that work on the batch.
struct BatchControl {
  // Whether the answer is not wanted any more; once true, always. Asked within queries, too.
  std::function<bool()> cancelled = [] { return false; };
  // Called between queries, with no lock held: others may have their turn on this thread.
  std::function<void()> pause = [] {};
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_BATCH_CONTROL_H_
