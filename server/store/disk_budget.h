// The bytes that meshes may take on disk.

#ifndef SERVER_STORE_DISK_BUDGET_H_
#define SERVER_STORE_DISK_BUDGET_H_

#include <atomic>
#include <cstdint>
#include <functional>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"

namespace deltaray {

// Counts what is on its way to the directory beside what is there. Servers that share a directory see what others have
// stored, but not what is on its way to them. Thread-safe.
class DiskBudget {
 public:
  // Bytes of one upload, until it is destroyed. Not thread-safe.
  class Charge {
   public:
    explicit Charge(DiskBudget* budget) : budget_(budget) {}
    Charge(Charge&& other) noexcept : budget_(other.budget_), bytes_(std::exchange(other.bytes_, 0)) {}
    Charge& operator=(Charge&&) = delete;
    ~Charge() { budget_->on_their_way_ -= bytes_; }

    // RESOURCE_EXHAUSTED where there is no room for `bytes` more.
    absl::Status Add(uint64_t bytes) {
      const uint64_t on_their_way = budget_->on_their_way_ += bytes;
      bytes_ += bytes;
      if (on_their_way + budget_->stored_() <= budget_->limit_) return absl::OkStatus();
      return absl::ResourceExhaustedError(absl::StrCat("all meshes together would take more than ", budget_->limit_,
                                                       " bytes on disk (--max-stored-bytes)"));
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
  std::atomic<uint64_t> on_their_way_{0};
};

}  // namespace deltaray

#endif  // SERVER_STORE_DISK_BUDGET_H_
