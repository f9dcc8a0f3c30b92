#include "server/store/tree_budget.h"

#include <malloc.h>

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

TreeBudget::Reservation::~Reservation() { budget_->GiveBack(bytes_); }

absl::Status TreeBudget::Reservation::GrowTo(uint64_t bytes) {
  MutexLock lock(mutex_);
  if (bytes <= bytes_) return absl::OkStatus();
  const auto deadline = std::chrono::steady_clock::now() + kGrowPatience;
  while (!budget_->TryTake(bytes - bytes_)) {
    if (bytes > budget_->limit()) {
      return absl::ResourceExhaustedError(
          absl::StrCat("the mesh takes more memory than the limit of ", budget_->limit(), " bytes (--tree-bytes)"));
    }
    if (budget_->evict_()) continue;
    if (std::chrono::steady_clock::now() >= deadline) {
      return absl::ResourceExhaustedError(absl::StrCat("no memory is free of the limit of ", budget_->limit(),
                                                       " bytes (--tree-bytes): trees are being built or used; retry"));
    }
    budget_->AwaitChange();
  }
  bytes_ = bytes;
  return absl::OkStatus();
}

void TreeBudget::Reservation::ShrinkTo(uint64_t bytes) {
  MutexLock lock(mutex_);
  if (bytes >= bytes_) return;
  budget_->GiveBack(bytes_ - bytes);
  bytes_ = bytes;
}

std::shared_ptr<TreeBudget::Reservation> TreeBudget::Reservation::Split(uint64_t bytes) {
  MutexLock lock(mutex_);
  if (bytes > bytes_) {
    budget_->Take(bytes - bytes_);
    bytes_ = bytes;
  }
  auto split = std::make_shared<Reservation>(budget_, bytes);
  bytes_ -= bytes;
  return split;
}

absl::StatusOr<std::shared_ptr<TreeBudget::Reservation>> TreeBudget::Reserve(uint64_t bytes, absl::string_view what,
                                                                             const std::function<bool()>& cancelled) {
  if (bytes > limit_) {
    return absl::ResourceExhaustedError(absl::StrCat(what, " takes up to ", bytes,
                                                     " bytes while its tree is built, more than the limit of ", limit_,
                                                     " bytes (--tree-bytes)"));
  }
  MutexLock turn(turn_mutex_);
  while (!TryTake(bytes)) {
    if (cancelled()) return absl::CancelledError("cancelled while it waited for memory");
    if (!evict_()) AwaitChange();
  }
  return std::make_shared<Reservation>(shared_from_this(), bytes);
}

uint64_t TreeBudget::used() const {
  MutexLock lock(mutex_);
  return used_;
}

bool TreeBudget::TryTake(uint64_t bytes) {
  MutexLock lock(mutex_);
  if (used_ > limit_ || bytes > limit_ - used_) return false;
  used_ += bytes;
  return true;
}

void TreeBudget::Take(uint64_t bytes) {
  MutexLock lock(mutex_);
  used_ += bytes;
}

void TreeBudget::GiveBack(uint64_t bytes) {
  if (IsTimeToTrim(bytes)) malloc_trim(0);
  MutexLock lock(mutex_);
  used_ -= bytes;
  changed_.notify_all();
}

bool TreeBudget::IsTimeToTrim(uint64_t freed) {
  MutexLock lock(mutex_);
  freed_ += freed;
  if (freed_ < kTrimBytes) return false;
  freed_ = 0;
  return true;
}

void TreeBudget::AwaitChange() {
  MutexLock lock(mutex_);
  changed_.wait_for(mutex_, kLookAgain);
}

}  // namespace deltaray
