#include "server/store/tree_budget.h"

#include <malloc.h>

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"

namespace deltaray {
namespace {

// A tree in use becomes one that can be dropped without anybody telling.
constexpr std::chrono::milliseconds kLookAgain{20};
// An upload that is being read has memory itself: two of them must not wait for each other.
constexpr std::chrono::seconds kGrowPatience{5};
// malloc keeps what is freed until it is told to give it back, which takes a look at all that is free.
constexpr uint64_t kTrimBytes = uint64_t{4} << 20;

}  // namespace

absl::Status TreeBudget::Reservation::GrowTo(uint64_t bytes) {
  const auto deadline = std::chrono::steady_clock::now() + kGrowPatience;
  while (!budget_->GrowOrWait(*this, bytes)) {
    if (bytes > budget_->limit()) {
      return absl::ResourceExhaustedError(
          absl::StrCat("the mesh takes more memory than the limit of ", budget_->limit(), " bytes (--tree-bytes)"));
    }
    if (std::chrono::steady_clock::now() >= deadline) {
      return absl::ResourceExhaustedError(absl::StrCat("no memory is free of the limit of ", budget_->limit(),
                                                       " bytes (--tree-bytes): trees are being built or used; retry"));
    }
  }
  return absl::OkStatus();
}

void TreeBudget::Reservation::ShrinkTo(uint64_t bytes) {
  uint64_t freed;
  {
    MutexLock lock(budget_->mutex_);
    if (bytes >= bytes_) return;
    freed = bytes_ - bytes;
    bytes_ = bytes;
    // Nobody need drop a tree for these while the system gets them back.
    if (!retired_) budget_->returning_ += freed;
  }
  budget_->TrimAfter(freed);
  MutexLock lock(budget_->mutex_);
  budget_->used_ -= freed;
  budget_->returning_ -= freed;
  budget_->changed_.notify_all();
}

std::shared_ptr<TreeBudget::Reservation> TreeBudget::Reservation::Split(uint64_t bytes) {
  const std::shared_ptr<Reservation> split = budget_->Empty();
  MutexLock lock(budget_->mutex_);
  const uint64_t given = std::min(bytes, bytes_);
  bytes_ -= given;
  if (retired_) budget_->returning_ -= given;
  budget_->used_ += bytes - given;
  split->bytes_ = bytes;
  return split;
}

void TreeBudget::Reservation::Retire() {
  MutexLock lock(budget_->mutex_);
  if (!std::exchange(retired_, true)) budget_->returning_ += bytes_;
}

uint64_t TreeBudget::Reservation::bytes() const {
  MutexLock lock(budget_->mutex_);
  return bytes_;
}

class TreeBudget::Turn {
 public:
  explicit Turn(TreeBudget* budget) : budget_(budget) {
    MutexLock lock(budget_->mutex_);
    budget_->turns_.push_back(this);
  }
  Turn(const Turn&) = delete;
  Turn& operator=(const Turn&) = delete;
  ~Turn() {
    MutexLock lock(budget_->mutex_);
    budget_->turns_.remove(this);
    budget_->changed_.notify_all();
  }

  bool HasCome() const {
    MutexLock lock(budget_->mutex_);
    return budget_->turns_.front() == this;
  }

 private:
  TreeBudget* const budget_;
};

absl::Status TreeBudget::CheckFits(uint64_t bytes, absl::string_view what) const {
  if (bytes <= limit_) return absl::OkStatus();
  return absl::ResourceExhaustedError(absl::StrCat(what, " takes up to ", bytes,
                                                   " bytes while its tree is built, more than the limit of ", limit_,
                                                   " bytes (--tree-bytes)"));
}

absl::StatusOr<std::shared_ptr<TreeBudget::Reservation>> TreeBudget::Reserve(uint64_t bytes, absl::string_view what,
                                                                             const std::function<bool()>& cancelled) {
  if (absl::Status status = CheckFits(bytes, what); !status.ok()) return status;
  std::shared_ptr<Reservation> reservation = Empty();
  const Turn turn(this);
  for (;;) {
    if (!turn.HasCome()) {
      AwaitChange();
    } else if (GrowOrWait(*reservation, bytes)) {
      return reservation;
    }
    if (cancelled()) return absl::CancelledError("cancelled while it waited for memory");
  }
}

uint64_t TreeBudget::used() const {
  MutexLock lock(mutex_);
  return used_;
}

bool TreeBudget::TryGrow(Reservation& reservation, uint64_t bytes) {
  MutexLock lock(mutex_);
  if (bytes <= reservation.bytes_) return true;
  const uint64_t more = bytes - reservation.bytes_;
  if (used_ > limit_ || more > limit_ - used_) return false;
  used_ += more;
  reservation.bytes_ = bytes;
  return true;
}

bool TreeBudget::GrowOrWait(Reservation& reservation, uint64_t bytes) {
  if (TryGrow(reservation, bytes)) return true;
  const uint64_t missing = Missing(bytes - reservation.bytes());
  if (missing != 0 && make_room_(missing)) return TryGrow(reservation, bytes);
  AwaitChange();
  return false;
}

uint64_t TreeBudget::Missing(uint64_t bytes) const {
  MutexLock lock(mutex_);
  const uint64_t wanted = used_ - returning_ + bytes;
  return wanted - std::min(wanted, limit_);
}

void TreeBudget::TrimAfter(uint64_t freed) {
  {
    MutexLock lock(mutex_);
    freed_ += freed;
    if (freed_ < kTrimBytes) return;
    freed_ = 0;
  }
  malloc_trim(0);
}

void TreeBudget::AwaitChange() {
  MutexLock lock(mutex_);
  changed_.wait_for(mutex_, kLookAgain);
}

}  // namespace deltaray
