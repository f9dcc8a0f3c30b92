#include "client/ray_stream.h"

#include <atomic>
#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include "absl/strings/str_cat.h"
#include "client/exit_code.h"

namespace deltaray {
namespace {

using Stream = grpc::ClientReaderWriter<v1::StreamRaysRequest, v1::StreamRaysResponse>;

// Ray counts of the batches that are sent and not yet answered. Shared by the two threads.
class Window {
 public:
  // Waits for a free place. Returns false once closed.
  bool Enter(uint32_t ray_count) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return closed_ || unanswered_.size() < kStreamWindow; });
    if (closed_) return false;
    unanswered_.push_back(ray_count);
    ++entered_;
    return true;
  }

  // Frees the place of the oldest batch and returns its ray count; -1 where none is unanswered.
  int64_t Leave() {
    const std::lock_guard lock(mutex_);
    if (unanswered_.empty()) return -1;
    const uint32_t ray_count = unanswered_.front();
    unanswered_.pop_front();
    changed_.notify_one();
    return ray_count;
  }

  // Lets no more batches in.
  void Close() {
    const std::lock_guard lock(mutex_);
    closed_ = true;
    changed_.notify_one();
  }

  // Batches let in so far.
  uint64_t entered() const {
    const std::lock_guard lock(mutex_);
    return entered_;
  }

 private:
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<uint32_t> unanswered_;
  uint64_t entered_ = 0;
  bool closed_ = false;
};

// Sends all batches, then ends the sending half. Returns the error of `next`; that of the RPC, Finish() will tell. Sets
// `input_ended` once it needs `next` no more.
absl::Status SendBatches(Stream& stream, Window& window, NextBatch next, std::atomic<bool>& input_ended) {
  while (true) {
    OutgoingBatch batch;
    const absl::StatusOr<bool> more = next(batch);
    if (!more.ok() || !*more) {
      input_ended = true;
      if (more.ok()) stream.WritesDone();
      return more.status();
    }
    if (!window.Enter(batch.ray_count)) return absl::OkStatus();
    v1::StreamRaysRequest request;
    *request.mutable_rays() = std::move(batch.rays);
    if (!stream.Write(request)) return absl::OkStatus();
  }
}

absl::Status BadReply(uint64_t batch, absl::string_view what) {
  return LocalError(absl::StrCat("the server's reply to batch ", batch, " ", what));
}

// Takes replies until the server sends no more; counts them in `answered`.
absl::Status ReceiveHits(Stream& stream, Window& window, TakeHits take, uint64_t* answered) {
  v1::StreamRaysResponse response;
  for (; stream.Read(&response); ++*answered) {
    if (response.batch_number() != *answered) {
      return BadReply(*answered, absl::StrCat("has the number ", response.batch_number()));
    }
    const int64_t sent = window.Leave();
    if (sent != response.hits().ray_count()) {
      return BadReply(*answered, absl::StrCat("is for ", response.hits().ray_count(), " rays, not ", sent));
    }
    absl::Status status = take(response.hits());
    if (!status.ok()) return status;
  }
  return absl::OkStatus();
}

// Compares the server's own count of batches with ours, since gRPC can report a stream that broke as one that ended.
absl::Status CheckCounts(const grpc::ClientContext& context, uint64_t sent, uint64_t answered) {
  if (sent != answered) return LocalError(absl::StrCat("the server answered ", answered, " of ", sent, " batches"));
  const auto& trailers = context.GetServerTrailingMetadata();
  const auto count = trailers.find("deltaray-batches");
  if (count == trailers.end()) return LocalError("the server's reply ends without deltaray-batches");
  const absl::string_view text(count->second.data(), count->second.size());
  if (text == absl::StrCat(sent)) return absl::OkStatus();
  return LocalError(absl::StrCat("the server counts ", text, " batches, but ", sent, " were sent"));
}

}  // namespace

absl::Status StreamBatches(Connection& connection, const v1::StreamStart& start, NextBatch next, TakeHits take) {
  grpc::ClientContext context;
  const StopSignal::Scope scope(connection.stop(), context);
  const std::unique_ptr<Stream> stream = connection.rays().StreamRays(&context);
  v1::StreamRaysRequest first;
  *first.mutable_start() = start;
  stream->Write(first);

  Window window;
  std::atomic<bool> input_ended = false;
  absl::Status send_status;
  std::thread sender([&] {
    send_status = SendBatches(*stream, window, next, input_ended);
    if (!send_status.ok()) context.TryCancel();
  });
  uint64_t answered = 0;
  const absl::Status receive_status = ReceiveHits(*stream, window, take, &answered);
  if (!receive_status.ok()) context.TryCancel();
  const bool interrupted = connection.stop().fired();
  window.Close();
  const grpc::Status rpc_status = stream->Finish();

  // Where the RPC ended before the input did, the sender may still wait for input: wake it, its answer counts no more.
  const bool input_ended_first = input_ended;
  if (!input_ended_first) connection.stop().Fire();
  sender.join();

  if (!receive_status.ok()) return receive_status;
  if (interrupted) return Interrupted();
  if (input_ended_first && !send_status.ok()) return send_status;
  if (!rpc_status.ok()) return FromRpc(rpc_status, context);
  return CheckCounts(context, window.entered(), answered);
}

}  // namespace deltaray
