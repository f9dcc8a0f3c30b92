// The memory that meshes and their trees may take.

#ifndef SERVER_STORE_TREE_BUDGET_H_
#define SERVER_STORE_TREE_BUDGET_H_

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/build/mutex.h"

namespace deltaray {

// Counts the bytes of geometry and trees, those of builds and of uploads that are being read included. Who needs more
// than is free has trees dropped that nobody has used for longest, and waits for those in use. Thread-safe.
class TreeBudget : public std::enable_shared_from_this<TreeBudget> {
 public:
  // Bytes that are taken until it is destroyed. Thread-safe.
  class Reservation {
   public:
    Reservation(std::shared_ptr<TreeBudget> budget, uint64_t bytes) : budget_(std::move(budget)), bytes_(bytes) {}
    Reservation(const Reservation&) = delete;
    Reservation& operator=(const Reservation&) = delete;
    ~Reservation();

    // Where `bytes` is more than before, waits a little for room; then RESOURCE_EXHAUSTED, and nothing has changed.
    absl::Status GrowTo(uint64_t bytes);
    void ShrinkTo(uint64_t bytes);
    // Gives `bytes` of it away; where it has not as many, the budget may be exceeded: they are taken, whatever was
    // expected.
    std::shared_ptr<Reservation> Split(uint64_t bytes);

   private:
    const std::shared_ptr<TreeBudget> budget_;  // trees may outlive the store
    Mutex mutex_;
    uint64_t bytes_ ABSL_GUARDED_BY(mutex_);
  };

  // `evict` drops the tree, or geometry, that was not used for longest, of those that can be dropped; false where there
  // is none. It is called without a lock, from threads that need room. A budget is held by shared_ptr.
  TreeBudget(uint64_t limit, std::function<bool()> evict) : limit_(limit), evict_(std::move(evict)) {}

  // Waits until there is room for `bytes`: one after the other, so that who needs much gets its turn.
  // RESOURCE_EXHAUSTED where that can never be, with a text of `what` that needs them; CANCELLED once `cancelled`
  // returns true.
  absl::StatusOr<std::shared_ptr<Reservation>> Reserve(uint64_t bytes, absl::string_view what,
                                                       const std::function<bool()>& cancelled);
  // None yet, to grow.
  std::shared_ptr<Reservation> Empty() { return std::make_shared<Reservation>(shared_from_this(), 0); }

  uint64_t limit() const { return limit_; }
  uint64_t used() const;

 private:
  bool TryTake(uint64_t bytes);
  void Take(uint64_t bytes);
  // The memory has been freed; the system has it back by and by.
  void GiveBack(uint64_t bytes);
  bool IsTimeToTrim(uint64_t freed);
  // Waits until something was given back, or a while.
  void AwaitChange();

  const uint64_t limit_;
  const std::function<bool()> evict_;
  Mutex turn_mutex_ ABSL_ACQUIRED_BEFORE(mutex_);  // held by who waits in Reserve
  mutable Mutex mutex_;
  Condition changed_;
  uint64_t used_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t freed_ ABSL_GUARDED_BY(mutex_) = 0;  // since the last trim
};

}  // namespace deltaray

#endif  // SERVER_STORE_TREE_BUDGET_H_
