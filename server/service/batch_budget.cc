#include "server/service/batch_budget.h"

#include <algorithm>
#include <utility>

namespace deltaray {
namespace {

using std::chrono::steady_clock;

// So many streams may begin at once before anything is known of them.
constexpr uint64_t kFirstStreams = 16;
// Unary calls that wait hold messages of at most this part of the budget.
constexpr uint64_t kWaitingPart = 4;

}  // namespace

absl::Status ReplyLostError() {
  return absl::ResourceExhaustedError(
      "the reply was not taken while the memory for batches was short (--batch-bytes); retry later");
}

BatchBudget::BatchBudget(uint64_t limit) : limit_(limit), first_expectation_(limit / kFirstStreams) {}

BatchBudget::Share::~Share() {
  MutexLock lock(budget_->mutex_);
  budget_->LeaveLine(*this);
  budget_->SetStage(*this, Stage::kNone);
  budget_->SetBytes(*this, 0);
  budget_->Serve();
}

bool BatchBudget::Share::Expect(uint64_t bytes, std::function<void()> granted) {
  MutexLock lock(budget_->mutex_);
  wanted_ = bytes;
  if (bytes <= kFreeBytes || budget_->MayHaveNow(*this)) {
    budget_->SetStage(*this, Stage::kExpected);
    budget_->Grant(*this);
    return true;
  }
  callback_ = std::move(granted);
  since_ = steady_clock::now();
  budget_->expect_line_.push_back(this);
  return false;
}

BatchBudget::Answer BatchBudget::Share::Begin(uint64_t message_bytes, uint64_t bytes, bool may_refuse,
                                              std::function<void()> granted) {
  MutexLock lock(budget_->mutex_);
  if (stage_ == Stage::kExpected) budget_->first_expectation_ = std::max(budget_->first_expectation_, bytes);
  wanted_ = bytes;
  if (bytes <= std::max(bytes_, kFreeBytes) || budget_->MayHaveNow(*this)) {
    budget_->SetStage(*this, Stage::kWorking);
    budget_->Grant(*this);
    budget_->Serve();
    return Answer::kNow;
  }
  if (may_refuse && budget_->refusable_waiting_ + message_bytes > budget_->limit_ / kWaitingPart) {
    return Answer::kNever;
  }
  // What is there is there, whether there is room for it or not.
  budget_->SetBytes(*this, std::max(bytes_, message_bytes));
  budget_->SetStage(*this, Stage::kWaiting);
  may_refuse_ = may_refuse;
  if (may_refuse) budget_->refusable_waiting_ += bytes_;
  callback_ = std::move(granted);
  since_ = steady_clock::now();
  budget_->begin_line_.push_back(this);
  return Answer::kLater;
}

void BatchBudget::Share::Reply(uint64_t bytes, std::function<void()> lost) {
  MutexLock lock(budget_->mutex_);
  budget_->SetStage(*this, Stage::kReply);
  budget_->SetBytes(*this, bytes);
  callback_ = std::move(lost);
  budget_->Serve();
}

void BatchBudget::Share::NoteProgress() {
  MutexLock lock(budget_->mutex_);
  since_ = steady_clock::now();
}

void BatchBudget::Share::Withdraw() {
  std::function<void()> dropped;
  MutexLock lock(budget_->mutex_);
  if (budget_->LeaveLine(*this)) dropped = std::exchange(callback_, nullptr);
  budget_->Serve();
}

bool BatchBudget::IsTight() const {
  MutexLock lock(mutex_);
  return used_ > limit_ / 2 || Oldest() != nullptr;
}

uint64_t BatchBudget::first_expectation() const {
  MutexLock lock(mutex_);
  return first_expectation_;
}

uint64_t BatchBudget::used() const {
  MutexLock lock(mutex_);
  return used_;
}

void BatchBudget::Tick(steady_clock::time_point now) {
  MutexLock lock(mutex_);
  if (Oldest() == nullptr) return;
  bool silent = false;
  for (Share* const share : expected_) {
    const auto patience = share == excess_ ? kExcessPatience : kPatience;
    if (share->bytes_ <= kFreeBytes || now - share->since_ < patience) continue;
    SetBytes(*share, kFreeBytes);
    if (share == excess_) excess_ = nullptr;
    silent = true;
  }
  if (silent) first_expectation_ = std::max(first_expectation_ / 2, kFreeBytes);
  TakeBackReplies(now);
  Serve();
}

void BatchBudget::TakeBackReplies(steady_clock::time_point now) {
  uint64_t lost = 0;
  while (!replies_.empty() && used_ - lost + Oldest()->wanted_ - Oldest()->bytes_ > limit_) {
    Share& slowest = **std::min_element(replies_.begin(), replies_.end(),
                                        [](const Share* a, const Share* b) { return a->since_ < b->since_; });
    if (now - slowest.since_ < kStall) return;
    Call(slowest);
    // Once: its bytes come back when it is destroyed.
    replies_.erase(&slowest);
    lost += slowest.bytes_;
  }
}

void BatchBudget::SetBytes(Share& share, uint64_t bytes) {
  used_ += bytes - share.bytes_;
  share.bytes_ = bytes;
}

void BatchBudget::SetStage(Share& share, Share::Stage stage) {
  working_ -= share.stage_ == Share::Stage::kWorking;
  if (share.stage_ == Share::Stage::kExpected) expected_.erase(&share);
  if (share.stage_ == Share::Stage::kReply) replies_.erase(&share);
  share.stage_ = stage;
  share.since_ = steady_clock::now();
  working_ += stage == Share::Stage::kWorking;
  if (stage == Share::Stage::kExpected) expected_.insert(&share);
  if (stage == Share::Stage::kReply) replies_.insert(&share);
  // One that waits for more is in line with all others; were it still the one, it and the first would wait for each
  // other.
  if (&share == excess_ && (stage == Share::Stage::kWaiting || stage == Share::Stage::kNone)) excess_ = nullptr;
}

BatchBudget::Share* BatchBudget::Oldest() const {
  if (begin_line_.empty() || expect_line_.empty()) {
    const Line& line = begin_line_.empty() ? expect_line_ : begin_line_;
    return line.empty() ? nullptr : line.front();
  }
  return begin_line_.front()->since_ <= expect_line_.front()->since_ ? begin_line_.front() : expect_line_.front();
}

bool BatchBudget::Fits(const Share& share) const { return used_ + share.wanted_ - share.bytes_ <= limit_; }

bool BatchBudget::MayExceed(const Share& share) const {
  // The former one counts to its end, its reply included, or clients that take none would let in more and more.
  return working_ == 0 && (excess_ == nullptr || excess_ == &share || used_ <= limit_);
}

bool BatchBudget::MayHaveNow(const Share& share) const {
  return Oldest() == nullptr && (Fits(share) || MayExceed(share));
}

void BatchBudget::Grant(Share& share) {
  if (!Fits(share) && share.wanted_ > kFreeBytes) excess_ = &share;
  SetBytes(share, share.wanted_);
}

void BatchBudget::Serve() {
  while (Share* share = Oldest()) {
    if (!Fits(*share)) {
      // A message that is there holds memory until its batch is done: it goes before one that is yet to be read.
      if (!begin_line_.empty()) share = begin_line_.front();
      if (!MayExceed(*share)) return;
    }
    const bool begins = share->stage_ == Share::Stage::kWaiting;
    LeaveLine(*share);
    SetStage(*share, begins ? Share::Stage::kWorking : Share::Stage::kExpected);
    Grant(*share);
    Call(*share);
  }
}

bool BatchBudget::LeaveLine(Share& share) {
  for (Line* const line : {&begin_line_, &expect_line_}) {
    const auto place = std::find(line->begin(), line->end(), &share);
    if (place == line->end()) continue;
    if (line == &begin_line_ && share.may_refuse_) refusable_waiting_ -= share.bytes_;
    line->erase(place);
    return true;
  }
  return false;
}

void BatchBudget::Call(Share& share) {
  if (share.callback_ != nullptr) callbacks_.Run(std::exchange(share.callback_, nullptr));
}

}  // namespace deltaray
