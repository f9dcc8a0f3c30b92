// The bytes that meshes may take on disk.

#ifndef SERVER_STORE_DISK_BUDGET_H_
#define SERVER_STORE_DISK_BUDGET_H_

#include <cstdint>
#include <functional>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "server/build/mutex.h"

namespace deltaray {

// Counts what is on its way to the directory beside what is there. Servers that share a directory see what others have
// stored, but not what is on its way to them. Thread-safe.
class DiskBudget {
 public:
  // Bytes of one upload, until they are given back. Not thread-safe.
  class Charge {
   public:
    explicit Charge(DiskBudget* budget) : budget_(budget) {}
    Charge(Charge&& other) noexcept : budget_(other.budget_), bytes_(std::exchange(other.bytes_, 0)) {}
    Charge& operator=(Charge&&) = delete;
    ~Charge() { GiveBack(); }

    // RESOURCE_EXHAUSTED, and nothing has changed, where there is no room for `bytes` more.
    absl::Status Add(uint64_t bytes) {
      MutexLock lock(budget_->mutex_);
      if (budget_->on_their_way_ + bytes + budget_->stored_() > budget_->limit_) {
        return absl::ResourceExhaustedError(absl::StrCat("all meshes together would take more than ", budget_->limit_,
                                                         " bytes on disk (--max-stored-bytes)"));
      }
      budget_->on_their_way_ += bytes;
      bytes_ += bytes;
      return absl::OkStatus();
    }
    // Gives the bytes back. `arrive` makes them count as stored, where they do: nobody sees them twice or not at all.
    void GiveBack(const std::function<void()>& arrive = [] {}) {
      MutexLock lock(budget_->mutex_);
      arrive();
      budget_->on_their_way_ -= std::exchange(bytes_, 0);
    }

   private:
    DiskBudget* const budget_;
    uint64_t bytes_ = 0;
  };

  // `stored`: bytes of the meshes that are there.
  DiskBudget(uint64_t limit, std::function<uint64_t()> stored) : limit_(limit), stored_(std::move(stored)) {}

 private:
  const uint64_t limit_;
  const std::function<uint64_t()> stored_;
  Mutex mutex_;
  uint64_t on_their_way_ ABSL_GUARDED_BY(mutex_) = 0;
};

}  // namespace deltaray

#endif  // SERVER_STORE_DISK_BUDGET_H_
