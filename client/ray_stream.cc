#include "client/ray_stream.h"

#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "client/exit_code.h"
#include "client/retry.h"

namespace deltaray {
namespace {

using Stream = grpc::ClientReaderWriter<v1::StreamRaysRequest, v1::StreamRaysResponse>;
using Request = std::shared_ptr<const v1::StreamRaysRequest>;

// The batches that are read and not yet answered, oldest first. They are kept until they are, so that another server
// can be asked. Shared by the threads that read, send and receive.
class Window {
 public:
  // Reading: waits for a free place. Returns false once closed.
  bool Enter(OutgoingBatch batch) {
    auto request = std::make_shared<v1::StreamRaysRequest>();
    *request->mutable_rays() = std::move(batch.rays);
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return closed_ || unanswered_.size() < kStreamWindow; });
    if (closed_) return false;
    unanswered_.push_back({std::move(request), batch.ray_count});
    ++entered_;
    changed_.notify_all();
    return true;
  }

  // Reading: there are no more batches, or an error in place of them.
  void EndInput(absl::Status status) {
    const std::lock_guard lock(mutex_);
    input_ended_ = true;
    input_status_ = std::move(status);
    changed_.notify_all();
  }

  // Sending: waits for a batch that is not yet sent. nullptr where none comes any more, or sending is to stop.
  Request NextToSend() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock,
                  [this] { return !sending_ || !input_status_.ok() || sent_ < unanswered_.size() || input_ended_; });
    if (!sending_ || !input_status_.ok() || sent_ == unanswered_.size()) return nullptr;
    return unanswered_[sent_++].request;
  }

  // Sending starts anew, with the oldest batch.
  void StartSending() {
    const std::lock_guard lock(mutex_);
    sending_ = true;
    sent_ = 0;
  }
  void StopSending() {
    const std::lock_guard lock(mutex_);
    sending_ = false;
    changed_.notify_all();
  }

  // Receiving: frees the place of the oldest batch and returns its ray count; -1 where none that was sent is
  // unanswered.
  int64_t Leave() {
    const std::lock_guard lock(mutex_);
    if (sent_ == 0) return -1;
    const uint32_t ray_count = unanswered_.front().ray_count;
    unanswered_.pop_front();
    --sent_;
    changed_.notify_all();
    return ray_count;
  }

  // Lets no more batches in.
  void Close() {
    const std::lock_guard lock(mutex_);
    closed_ = true;
    changed_.notify_all();
  }

  bool input_ended() const {
    const std::lock_guard lock(mutex_);
    return input_ended_;
  }
  // OK as long as the input has not ended.
  absl::Status input_status() const {
    const std::lock_guard lock(mutex_);
    return input_status_;
  }
  // Batches let in so far.
  uint64_t entered() const {
    const std::lock_guard lock(mutex_);
    return entered_;
  }

 private:
  struct Batch {
    Request request;
    uint32_t ray_count;
  };

  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Batch> unanswered_;
  size_t sent_ = 0;  // of them, in the current stream
  uint64_t entered_ = 0;
  bool sending_ = false;
  bool closed_ = false;
  bool input_ended_ = false;
  absl::Status input_status_;
};

// Reads batches until there are no more of them or the window is closed.
absl::Status ReadBatches(Window& window, NextBatch next) {
  while (true) {
    OutgoingBatch batch;
    const absl::StatusOr<bool> more = next(batch);
    if (!more.ok()) return more.status();
    if (!*more || !window.Enter(std::move(batch))) return absl::OkStatus();
  }
}

// Sends the start and all batches, then ends the sending half. How the RPC ends, Finish() will tell.
void SendBatches(Stream& stream, grpc::ClientContext& context, const v1::StreamStart& start, Window& window) {
  v1::StreamRaysRequest first;
  *first.mutable_start() = start;
  bool open = stream.Write(first);
  while (const Request request = open ? window.NextToSend() : nullptr) open = stream.Write(*request);
  if (!window.input_status().ok()) {
    context.TryCancel();
  } else if (open) {
    stream.WritesDone();
  }
}

absl::Status BadReply(uint64_t batch, absl::string_view what) {
  return LocalError(absl::StrCat("the server's reply to batch ", batch, " ", what));
}

// What is known of the answers so far, over all streams that it took to get them.
struct Answers {
  TakeHits take;
  uint64_t count = 0;
  uint64_t rays = 0;         // in them
  std::string mesh_id = {};  // that they are for; empty before the first one
};

// Takes replies until the server sends no more. The first one of this stream answers the batch `answers.count`.
absl::Status ReceiveHits(Stream& stream, Window& window, Retry& retry, Answers& answers) {
  v1::StreamRaysResponse response;
  for (uint64_t number = 0; stream.Read(&response); ++number) {
    if (response.batch_number() != number) {
      return BadReply(answers.count, absl::StrCat("has the number ", response.batch_number()));
    }
    const int64_t sent = window.Leave();
    if (sent != response.hits().ray_count()) {
      return BadReply(answers.count, absl::StrCat("is for ", response.hits().ray_count(), " rays, not ", sent));
    }
    if (answers.mesh_id.empty()) answers.mesh_id = response.mesh_id();
    if (answers.mesh_id != response.mesh_id()) return BadReply(answers.count, "is of another mesh");
    absl::Status status = answers.take(response.hits());
    if (!status.ok()) return status;
    ++answers.count;
    answers.rays += sent;
    retry.Succeeded();
  }
  return absl::OkStatus();
}

// Checks that nothing is left to answer, and compares the server's own count of batches with ours: gRPC can report a
// stream that broke as one that ended.
absl::Status CheckCounts(const grpc::ClientContext& context, const Window& window, uint64_t answered,
                         uint64_t answered_here) {
  if (!window.input_ended()) {
    return LocalError(absl::StrCat("the server ended the stream after ", answered, " batches, before all were sent"));
  }
  const uint64_t sent = window.entered();
  if (sent != answered) return LocalError(absl::StrCat("the server answered ", answered, " of ", sent, " batches"));
  const auto& trailers = context.GetServerTrailingMetadata();
  const auto count = trailers.find("deltaray-batches");
  if (count == trailers.end()) return LocalError("the server's reply ends without deltaray-batches");
  const absl::string_view text(count->second.data(), count->second.size());
  if (text == absl::StrCat(answered_here)) return absl::OkStatus();
  return LocalError(absl::StrCat("the server counts ", text, " batches, but ", answered_here, " were sent"));
}

// `status`, with the number in the whole input of the first ray of `batch` where the error is about that one: the
// server tells the ray in its batch, and the batch in its stream.
grpc::Status WithFirstRay(const grpc::Status& status, uint64_t batch, uint64_t ray) {
  const std::string prefix = absl::StrCat("batch ", batch, ": ");
  if (status.ok() || !absl::StartsWith(status.error_message(), prefix)) return status;
  return {status.error_code(), absl::StrCat(status.error_message(), "; batch ", batch, " begins with ray ", ray,
                                            " of the whole input, all counted from 0")};
}

// Runs one StreamRays RPC, for the batches that are not yet answered. True: it was lost, and is to be resumed.
absl::StatusOr<bool> RunStream(Connection& connection, absl::string_view key, const v1::StreamStart& start,
                               Window& window, Retry& retry, Answers& answers) {
  grpc::ClientContext context;
  connection.Prepare(key, &context);
  const StopSignal::Scope scope(connection.stop(), context);
  const std::unique_ptr<Stream> stream = connection.rays().StreamRays(&context);
  window.StartSending();
  std::thread sender([&] { SendBatches(*stream, context, start, window); });
  const uint64_t answered_before = answers.count;
  const absl::Status receive_status = ReceiveHits(*stream, window, retry, answers);
  if (!receive_status.ok()) context.TryCancel();
  const bool interrupted = connection.stop().fired();
  window.StopSending();
  // The server fails at the first batch that it does not answer.
  const grpc::Status failure = WithFirstRay(stream->Finish(), answers.count - answered_before, answers.rays);
  const grpc::Status rpc_status = WithRequestId(failure, context);
  sender.join();

  if (!receive_status.ok()) return receive_status;
  if (interrupted) return Interrupted();
  if (absl::Status input = window.input_status(); !input.ok()) return input;
  if (!rpc_status.ok()) {
    if (retry.Again(rpc_status)) return true;
    return connection.Result(rpc_status);
  }
  absl::Status counts = CheckCounts(context, window, answers.count, answers.count - answered_before);
  if (!counts.ok()) return counts;
  return false;
}

}  // namespace

absl::Status StreamBatches(Connection& connection, const v1::StreamStart& start, NextBatch next, TakeHits take) {
  Window window;
  std::thread reader([&] { window.EndInput(ReadBatches(window, next)); });
  Retry retry(connection);
  Answers answers{take};
  v1::StreamStart from_here = start;
  absl::StatusOr<bool> lost = true;
  while (lost.ok() && *lost) {
    // By id, so that a name that moves meanwhile does not bring in another mesh. The key stays: it leads to the servers
    // that have the tree.
    if (!answers.mesh_id.empty()) from_here.set_mesh(answers.mesh_id);
    lost = RunStream(connection, start.mesh(), from_here, window, retry, answers);
  }
  window.Close();
  // Where the RPC ended before the input did, the reader may still wait for input: wake it, its answer counts no more.
  if (!window.input_ended()) connection.stop().Fire();
  reader.join();
  return lost.status();
}

}  // namespace deltaray
