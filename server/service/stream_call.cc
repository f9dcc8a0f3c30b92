#include "server/service/stream_call.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "server/service/message_bytes.h"
#include "server/service/ray_message.h"

namespace deltaray {
namespace {

absl::Status Prefix(const absl::Status& status, const std::string& prefix) {
  return status.ok() ? status : absl::Status(status.code(), absl::StrCat(prefix, status.message()));
}

absl::Status RepliesLostError() {
  return absl::ResourceExhaustedError(
      absl::StrCat("replies were not taken for ", absl::FormatDuration(absl::FromChrono(BatchBudget::kStall)),
                   " while the memory for batches was short (--batch-bytes); read replies while sending"));
}

}  // namespace

grpc::ServerBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer>* StreamCall::Start(Calls* calls, const RpcInfo& rpc,
                                                                               const RayBackend& backend) {
  auto call = std::make_shared<StreamCall>(calls, backend);
  call->weak_self_ = call;
  if (Admit(call, rpc)) {
    MutexLock lock(call->mutex_);
    call->Advance();
  }
  return call.get();
}

void StreamCall::OnReadDone(bool ok) {
  std::vector<BatchPointer> batches;
  {
    MutexLock lock(mutex_);
    reading_ = false;
    const absl::Status status = CatchExceptions([&]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
      grpc::ByteBuffer message = std::exchange(incoming_, grpc::ByteBuffer());
      if (!ok || finished_ || draining_) return absl::OkStatus();
      if (target_ == nullptr) return TakeStart(std::move(message));
      TakeBatch(std::move(message));
      return absl::OkStatus();
    });
    if (!ok) reads_ended_ = true;
    if (!status.ok()) FinishOnce(status);
    incoming_share_ = nullptr;
    batches = Advance();
  }
  Work(batches);
}

absl::Status StreamCall::TakeStart(grpc::ByteBuffer message) {
  v1::StreamRaysRequest request;
  if (absl::Status status = ParseSmallMessage(std::move(message), &request); !status.ok()) return status;
  if (!request.has_start()) return absl::InvalidArgumentError("the first message of the stream must hold start");
  const absl::StatusOr<BatchQuery> query = ReadQuery(request.start().query());
  if (!query.ok()) return Prefix(query.status(), "start.");
  const std::string& mesh = request.start().mesh();
  if (const absl::StatusOr<std::string> id = backend_.store->ResolveKnown(mesh); id.ok()) return SetTarget(id, *query);
  finding_ = true;
  const auto self = weak_self_.lock();
  backend_.disk->Run([self, mesh, query = *query] { self->FindOnDisk(mesh, query); },
                     [self] { return self->cancelled(); });
  return absl::OkStatus();
}

void StreamCall::FindOnDisk(const std::string& mesh, const BatchQuery& query) {
  absl::StatusOr<std::string> id;
  const absl::Status found = CatchExceptions([&] {
    id = backend_.store->Resolve(mesh);
    return id.status();
  });
  std::vector<BatchPointer> batches;
  {
    MutexLock lock(mutex_);
    finding_ = false;
    const absl::Status status = SetTarget(found.ok() ? id : found, query);
    if (!status.ok()) FinishOnce(status);
    batches = Advance();
  }
  Work(batches);
}

absl::Status StreamCall::SetTarget(const absl::StatusOr<std::string>& id, const BatchQuery& query) {
  if (id.ok()) target_ = std::make_shared<const Target>(Target{*id, query});
  return Prefix(id.status(), "start.mesh: ");
}

void StreamCall::TakeBatch(grpc::ByteBuffer message) {
  auto batch = std::make_shared<Batch>();
  batch->number = batches_read_++;
  batch->share = std::move(incoming_share_);
  batch->request = std::move(message);
  batch->meter = std::make_shared<BatchMeter>(backend_.metrics, &record());
  const uint64_t bytes = batch->request.Length();
  const uint64_t needed_bytes = bytes + MaxAnswerBytes(target_->query, bytes, backend_.limits);
  // Clients send small batches between large ones.
  expected_bytes_ = std::max(needed_bytes, expected_bytes_ / 4 * 3);
  batch->admitted = batch->share->Begin(bytes, needed_bytes, /*may_refuse=*/false,
                                        [weak_self = weak_self_, weak_batch = std::weak_ptr<Batch>(batch)] {
                                          const auto self = weak_self.lock();
                                          const auto batch = weak_batch.lock();
                                          if (self != nullptr && batch != nullptr) self->OnRoomToAnswer(batch);
                                        }) == BatchBudget::Answer::kNow;
  line_.push_back(std::move(batch));
}

void StreamCall::ReadOn() {
  // The first message holds no rays.
  if (target_ != nullptr) {
    // What is in line calls for another look soon.
    if ((!line_.empty() || writing_) && backend_.budget->IsTight()) return;
    incoming_share_ = std::make_unique<BatchBudget::Share>(backend_.budget);
    if (expected_bytes_ == 0) expected_bytes_ = backend_.budget->first_expectation();
    const bool room = incoming_share_->Expect(expected_bytes_, [weak_self = weak_self_] {
      if (const auto self = weak_self.lock()) self->OnRoomToRead();
    });
    if (!room) return;
  }
  reading_ = true;
  StartRead(&incoming_);
}

void StreamCall::OnRoomToRead() {
  MutexLock lock(mutex_);
  if (finished_ || reading_ || incoming_share_ == nullptr) return;
  if (draining_) {
    incoming_share_ = nullptr;
    return;
  }
  NoteActivity();
  reading_ = true;
  StartRead(&incoming_);
}

void StreamCall::OnRoomToAnswer(const BatchPointer& batch) {
  std::vector<BatchPointer> batches;
  {
    MutexLock lock(mutex_);
    batch->admitted = true;
    batches = Advance();
  }
  Work(batches);
}

void StreamCall::OnWriteDone(bool ok) {
  std::vector<BatchPointer> batches;
  {
    MutexLock lock(mutex_);
    writing_ = false;
    outgoing_.Clear();
    outgoing_share_ = nullptr;
    for (const BatchPointer& batch : line_) {
      if (batch->done && batch->share != nullptr) batch->share->NoteProgress();
    }
    if (ok) {
      ++batches_answered_;
      batches = Advance();
    } else {
      FinishOnce(absl::CancelledError("the client has gone"));
    }
  }
  Work(batches);
}

void StreamCall::OnDrain() {
  MutexLock lock(mutex_);
  // A client that has sent all gets all its answers.
  draining_ = !reads_ended_;
  // Starts nothing new to work on: all batches in line that can be in hand are.
  Advance();
}

void StreamCall::BeforeFinish() { context_->AddTrailingMetadata("deltaray-batches", absl::StrCat(batches_answered_)); }

const char* StreamCall::MissingFromClient() const {
  if (writing_) return "not taken a reply";
  // Where nothing is read, the stream waits for the budget.
  return line_.empty() && reading_ ? "sent nothing" : nullptr;
}

std::vector<StreamCall::BatchPointer> StreamCall::Advance() {
  std::vector<BatchPointer> batches;
  if (finished_) return batches;
  NoteActivity();

  // Write the reply that is next, or end the call with the failure that is next.
  if (!writing_ && !line_.empty() && line_.front()->done) {
    const BatchPointer batch = std::move(line_.front());
    line_.pop_front();
    if (!batch->status.ok()) {
      FinishOnce(batch->status);
      return batches;
    }
    outgoing_.Swap(&batch->reply);
    outgoing_share_ = std::move(batch->share);
    writing_ = true;
    StartWrite(&outgoing_);
  }

  // End the call where nothing is left to do.
  if (!writing_ && line_.empty()) {
    if (draining_) {
      FinishOnce(DrainingError());
    } else if (reads_ended_ && target_ == nullptr) {
      FinishOnce(absl::InvalidArgumentError("the stream has no first message, which must hold start"));
    } else if (reads_ended_) {
      FinishOnce(absl::OkStatus());
    }
    if (finished_) return batches;
  }

  // Read on while there is room in line.
  if (!reading_ && !finding_ && incoming_share_ == nullptr && !reads_ended_ && !draining_ &&
      line_.size() + (writing_ ? 1 : 0) < kReadAhead) {
    ReadOn();
  }

  // Take the first in line in hand.
  for (size_t i = 0; i < std::min(line_.size(), kInHand); ++i) {
    if (!line_[i]->admitted || line_[i]->in_hand || line_[i]->done) continue;
    line_[i]->in_hand = true;
    batches.push_back(line_[i]);
  }
  return batches;
}

void StreamCall::Work(const std::vector<BatchPointer>& batches) {
  for (const BatchPointer& batch : batches) {
    const auto self = weak_self_.lock();
    const absl::Status status = CatchExceptions([&] {
      std::shared_ptr<const Target> target;
      {
        MutexLock lock(mutex_);
        target = target_;
      }
      const Expected expected = ExpectedOf(target->query, batch->request.Length());
      RunWhereExpected(*backend_.tracer, expected, [self, batch, expected] { self->Answer(batch, expected); });
      return absl::OkStatus();
    });
    if (!status.ok()) Complete(batch, status, {});
  }
}

void StreamCall::Answer(const BatchPointer& batch, Expected expected) {
  const std::string where = absl::StrCat("batch ", batch->number, ": ");
  const absl::Status status = CatchExceptions([&]() -> absl::Status {
    v1::StreamRaysRequest request;
    auto job = std::make_shared<BatchJob>();
    absl::Status parsed = ParseRayMessage(std::exchange(batch->request, grpc::ByteBuffer()), &request, &job->rays);
    if (!parsed.ok()) return parsed;
    if (!request.has_rays()) {
      return absl::InvalidArgumentError("all messages of the stream but the first one must hold rays");
    }
    {
      MutexLock lock(mutex_);
      job->mesh = target_->mesh_id;
      job->query = target_->query;
    }
    const auto self = weak_self_.lock();
    job->expected = expected;
    job->meter = std::move(batch->meter);
    job->cancelled = [self] { return self->cancelled(); };
    job->done = [self, batch, where](absl::StatusOr<BatchJob::Answer> answer) {
      grpc::ByteBuffer reply;
      const absl::Status status = CatchExceptions([&] {
        if (!answer.ok()) return answer.status();
        v1::StreamRaysResponse response;
        response.set_batch_number(batch->number);
        response.set_mesh_id(answer->mesh_id);
        reply = SerializeMessage(response, v1::StreamRaysResponse::kHitsFieldNumber, std::move(answer->hits));
        return absl::OkStatus();
      });
      self->Complete(batch, Prefix(status, where), std::move(reply));
    };
    RunBatch(backend_, std::move(job));
    return absl::OkStatus();
  });
  if (!status.ok()) Complete(batch, Prefix(status, where), {});
}

void StreamCall::Complete(const BatchPointer& batch, const absl::Status& status, grpc::ByteBuffer reply) {
  std::vector<BatchPointer> batches;
  {
    MutexLock lock(mutex_);
    if (batch->done) return;
    batch->done = true;
    batch->status = status;
    batch->reply.Swap(&reply);
    batch->share->Reply(batch->reply.Length(), CutOffLater(weak_self_, RepliesLostError()));
    batches = Advance();
  }
  Work(batches);
}

}  // namespace deltaray
