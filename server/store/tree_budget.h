// The memory that meshes and their trees may take.

#ifndef SERVER_STORE_TREE_BUDGET_H_
#define SERVER_STORE_TREE_BUDGET_H_

#include <chrono>
#include <cstdint>
#include <functional>
#include <list>
#include <memory>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/build/mutex.h"

namespace deltaray {

// Counts the bytes of geometry and trees, those of builds and of uploads that are being read included. Who needs more
// than is free has trees dropped that nobody has used for longest, as many as it takes, and waits for those in use.
// Thread-safe.
class TreeBudget : public std::enable_shared_from_this<TreeBudget> {
 public:
  // Bytes that are taken until it is destroyed. Thread-safe.
  class Reservation {
   public:
    explicit Reservation(std::shared_ptr<TreeBudget> budget) : budget_(std::move(budget)) {}
    Reservation(const Reservation&) = delete;
    Reservation& operator=(const Reservation&) = delete;
    ~Reservation() { ShrinkTo(0); }

    // Where `bytes` is more than before, waits a little for room; then RESOURCE_EXHAUSTED, and nothing has changed.
    absl::Status GrowTo(uint64_t bytes);
    void ShrinkTo(uint64_t bytes);
    // Gives `bytes` of it away; where it has not as many, the budget may be exceeded: they are taken, whatever was
    // expected.
    std::shared_ptr<Reservation> Split(uint64_t bytes);
    // What it is for was dropped: its bytes come back once those who still use that are done.
    void Retire();
    uint64_t bytes() const;

   private:
    friend class TreeBudget;

    const std::shared_ptr<TreeBudget> budget_;  // trees may outlive the store
    // Guarded by the budget's mutex.
    uint64_t bytes_ = 0;
    bool retired_ = false;
  };

  // `make_room(bytes)` drops trees, and geometry, that were not used for longest, until `bytes` in all come back, and
  // retires their reservations. Where all that it can drop has less, it drops nothing: what is in the way is being
  // built, and to drop trees for it would help nobody. Returns whether it has dropped any. It is called by one thread
  // or more that need room, without a lock of the budget. A budget is held by shared_ptr.
  TreeBudget(uint64_t limit, std::function<bool(uint64_t bytes)> make_room)
      : limit_(limit), make_room_(std::move(make_room)) {}

  // Waits until there is room for `bytes`: one after the other, so that who needs much gets its turn.
  // RESOURCE_EXHAUSTED as CheckFits; CANCELLED once `cancelled` returns true.
  absl::StatusOr<std::shared_ptr<Reservation>> Reserve(uint64_t bytes, absl::string_view what,
                                                       const std::function<bool()>& cancelled);
  // RESOURCE_EXHAUSTED where there can never be room for `bytes`, with a text of `what` that needs them.
  absl::Status CheckFits(uint64_t bytes, absl::string_view what) const;
  // None yet, to grow.
  std::shared_ptr<Reservation> Empty() { return std::make_shared<Reservation>(shared_from_this()); }

  uint64_t limit() const { return limit_; }
  uint64_t used() const;

 private:
  // A place in the line of those who wait in Reserve.
  class Turn;

  // Takes what `reservation` lacks of `bytes`; false: there is no room.
  bool TryGrow(Reservation& reservation, uint64_t bytes);
  // As TryGrow. Where there is no room, drops what makes it, or else waits until something was given back, or a while.
  bool GrowOrWait(Reservation& reservation, uint64_t bytes);
  // What must be dropped for `bytes` more, beside what was dropped already and comes back by and by.
  uint64_t Missing(uint64_t bytes) const;
  // Memory has been freed: has the system get it back now and then.
  void TrimAfter(uint64_t freed);
  void AwaitChange();

  const uint64_t limit_;
  const std::function<bool(uint64_t)> make_room_;
  mutable Mutex mutex_;
  Condition changed_;
  uint64_t used_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t returning_ ABSL_GUARDED_BY(mutex_) = 0;  // of those in use, what comes back without another drop
  uint64_t freed_ ABSL_GUARDED_BY(mutex_) = 0;      // since the last trim
  std::list<Turn*> turns_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace deltaray

#endif  // SERVER_STORE_TREE_BUDGET_H_
