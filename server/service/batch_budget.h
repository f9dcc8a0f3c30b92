// The memory that all batches in the server, and the replies of all other calls, may take together.

#ifndef SERVER_SERVICE_BATCH_BUDGET_H_
#define SERVER_SERVICE_BATCH_BUDGET_H_

#include <chrono>
#include <cstdint>
#include <functional>
#include <list>
#include <memory>
#include <unordered_set>

#include "absl/status/status.h"
#include "server/build/mutex.h"
#include "server/service/worker_pool.h"

namespace deltaray {

// What a call is told whose reply was not taken and is lost.
absl::Status ReplyLostError();

// Hands out shares of a number of bytes, in the order in which they are asked for. A share is of one batch, on its way
// through three stages:
//  1. its message is expected: room for it is kept before it is read;
//  2. it is worked on: its share is for the request, and for all that its answer can take;
//  3. its reply waits for the client to take it.
//
// Nobody waits forever:
//  - Shares of up to kFreeBytes are had at once.
//  - While nobody works, the first in line is let through although there is no room for it.
//  - A message that has not come for kPatience keeps no room from others.
//  - Where others wait for kStall, the client that has not taken its reply for longest, and for kStall at least, loses
//  it.
// So the bytes in use exceed the limit by the free shares, by one batch, and by messages that are there and wait; as
// many of these as may be refused are refused beyond a quarter of the limit.
//
// Thread-safe. Callbacks run on a thread of the budget's own, so they may take locks that are held around its methods.
class BatchBudget {
 public:
  static constexpr uint64_t kFreeBytes = 64 << 10;
  static constexpr std::chrono::milliseconds kPatience{1000};
  static constexpr std::chrono::milliseconds kExcessPatience{200};
  static constexpr std::chrono::milliseconds kStall{5000};

  enum class Answer { kNow, kLater, kNever };

  // Thread-safe. The budget outlives its shares.
  class Share {
   public:
    explicit Share(BatchBudget* budget) : budget_(budget) {}
    // Gives all of it back, and waits for nothing any more.
    ~Share();
    Share(const Share&) = delete;
    Share& operator=(const Share&) = delete;

    // Stage 1: asks for `bytes`. False: `granted` is called later, unless the share is destroyed before.
    bool Expect(uint64_t bytes, std::function<void()> granted);
    // Stage 2: the message is there, and `bytes` is what it and its answer can take in all. kLater: as above. Where
    // `may_refuse`, kNever: those that wait already hold too much.
    Answer Begin(uint64_t message_bytes, uint64_t bytes, bool may_refuse, std::function<void()> granted);
    // Stage 3: from now on it is for a reply of `bytes`. `lost` may be called, once: the reply is to be dropped.
    void Reply(uint64_t bytes, std::function<void()> lost);
    // Stage 3: the client has taken something.
    void NoteProgress();
    // Waits no more, and drops the callback.
    void Withdraw();

   private:
    friend class BatchBudget;
    enum class Stage { kNone, kExpected, kWaiting, kWorking, kReply };

    BatchBudget* const budget_;
    // Guarded by the budget's mutex.
    Stage stage_ = Stage::kNone;
    uint64_t bytes_ = 0;   // that it has
    uint64_t wanted_ = 0;  // where it is in a line, what it wants
    bool may_refuse_ = false;
    std::chrono::steady_clock::time_point since_;  // when it came to its stage or line
    std::function<void()> callback_;
  };

  explicit BatchBudget(uint64_t limit);

  // To be called several times a second.
  void Tick(std::chrono::steady_clock::time_point now);

  // Whether streams that have a batch in the server should not read another one ahead.
  bool IsTight() const;
  // What to expect of a stream that has sent no batch yet: at first much, less where clients keep silent, and as much
  // as the largest of late.
  uint64_t first_expectation() const;

  // Bytes in use, and how many may be.
  uint64_t used() const;
  uint64_t limit() const { return limit_; }

 private:
  using Line = std::list<Share*>;

  void TakeBackReplies(std::chrono::steady_clock::time_point now) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void SetBytes(Share& share, uint64_t bytes) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void SetStage(Share& share, Share::Stage stage) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // The share that has been in line for longest; nullptr where none is.
  Share* Oldest() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Whether there is room for what the share wants; whether it may have that without room; either, with none in line.
  bool Fits(const Share& share) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool MayExceed(const Share& share) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool MayHaveNow(const Share& share) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Gives it what it wants.
  void Grant(Share& share) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Grants to those in line what there is room for.
  void Serve() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // False: it was in none.
  bool LeaveLine(Share& share) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Call(Share& share) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const uint64_t limit_;
  mutable Mutex mutex_;
  uint64_t used_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t refusable_waiting_ ABSL_GUARDED_BY(mutex_) = 0;  // bytes of messages that wait and could have been refused
  uint64_t first_expectation_ ABSL_GUARDED_BY(mutex_);
  uint32_t working_ ABSL_GUARDED_BY(mutex_) = 0;
  const Share* excess_ ABSL_GUARDED_BY(mutex_) = nullptr;  // the one that was let through without room
  // Messages that are there, and those that are yet to be read, in order of arrival.
  Line begin_line_ ABSL_GUARDED_BY(mutex_), expect_line_ ABSL_GUARDED_BY(mutex_);
  std::unordered_set<Share*> expected_ ABSL_GUARDED_BY(mutex_), replies_ ABSL_GUARDED_BY(mutex_);
  WorkerPool callbacks_{1};
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_BATCH_BUDGET_H_
