// Whether somebody still waits for the answer of a query.

#ifndef SERVER_TREE_STOP_POLL_H_
#define SERVER_TREE_STOP_POLL_H_

#include <cstdint>
#include <functional>

namespace deltaray {

// Asks QueryOptions::stopped now and then. One object for a query.
class StopPoll {
 public:
  // `stopped`: nullptr where nobody ever stops the query; else it outlives this.
  explicit StopPoll(const std::function<bool()>* stopped) : stopped_(stopped) {}

  // To be called for every step of a traversal, or for several at once. Whether the query is to end.
  bool Step(uint32_t steps = 1) {
    left_ -= static_cast<int32_t>(steps);
    return left_ <= 0 && Ask();
  }

 private:
  // A ray takes some nanoseconds for a step, and some microseconds for one to a leaf that is all hard decisions.
  static constexpr int32_t kSteps = 1024;

  bool Ask() {
    // Once it is to end, every step asks: the traversals of one query all end.
    if (stopped_ != nullptr && (*stopped_)()) return true;
    left_ = kSteps;
    return false;
  }

  const std::function<bool()>* const stopped_;
  int32_t left_ = kSteps;
};

}  // namespace deltaray

#endif  // SERVER_TREE_STOP_POLL_H_
