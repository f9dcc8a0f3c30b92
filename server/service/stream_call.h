// One call of RayService.StreamRays.

#ifndef SERVER_SERVICE_STREAM_CALL_H_
#define SERVER_SERVICE_STREAM_CALL_H_

#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "grpcpp/server_context.h"
#include "grpcpp/support/byte_buffer.h"
#include "grpcpp/support/server_callback.h"
#include "server/service/batch_job.h"
#include "server/service/call_reactor.h"

namespace deltaray {

// Answers the batches of a stream in order, with bounded read-ahead.
//
// A batch that was read waits in line until its reply has been handed to gRPC and taken by it. At most kReadAhead
// batches are in line, and no more is read while they are: gRPC's flow control then stops the client, and the memory
// of a stream is bounded by kReadAhead requests and replies. The first kInHand batches in line are worked on, so that
// one is parsed or written while another is traced. Only the reply of the first batch in line is ever written, and
// only while no other write is under way. Each batch has a share of the BatchBudget, from before it is read until its
// reply is taken; a second one is read ahead only while the budget is not tight. A failure takes its place in line:
// replies to the batches before it are sent first, and then the status.
class StreamCall final : public CallReactor<grpc::ServerBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer>> {
 public:
  static constexpr size_t kReadAhead = 4;
  static constexpr size_t kInHand = 2;

  // Takes over a call: the reactor to give to gRPC.
  static grpc::ServerBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer>* Start(Calls* calls, const RpcInfo& rpc,
                                                                            const RayBackend& backend);

  StreamCall(Calls* calls, const RayBackend& backend) : CallReactor(calls), backend_(backend) {}

 private:
  // A batch in line.
  struct Batch {
    uint64_t number = 0;
    std::unique_ptr<BatchBudget::Share> share;
    grpc::ByteBuffer request;
    std::shared_ptr<BatchMeter> meter;  // until its job has it
    bool admitted = false;              // there is memory to answer it
    bool in_hand = false;
    // Once done:
    bool done = false;
    absl::Status status;
    grpc::ByteBuffer reply;
  };
  // What the first message asked for.
  struct Target {
    std::string mesh_id;
    BatchQuery query;
  };
  using BatchPointer = std::shared_ptr<Batch>;

  void OnReadDone(bool ok) override;
  void OnWriteDone(bool ok) override;
  void OnDrain() override;
  void BeforeFinish() override ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  const char* MissingFromClient() const override ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  // The first message: finds the mesh, on the disk where it is not known.
  absl::Status TakeStart(grpc::ByteBuffer message) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void FindOnDisk(const std::string& mesh, const BatchQuery& query) ABSL_LOCKS_EXCLUDED(mutex_);
  absl::Status SetTarget(const absl::StatusOr<std::string>& id, const BatchQuery& query)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // The others: puts what was read in line.
  void TakeBatch(grpc::ByteBuffer message) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Reads the next message, once there is room for it.
  void ReadOn() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // The budget has room: for the next message; for the batch.
  void OnRoomToRead() ABSL_LOCKS_EXCLUDED(mutex_);
  void OnRoomToAnswer(const BatchPointer& batch) ABSL_LOCKS_EXCLUDED(mutex_);
  // Starts whatever can be started now: a write, a read, the end of the call. Returns the batches to work on, to be
  // given to Work without the lock.
  std::vector<BatchPointer> Advance() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Work(const std::vector<BatchPointer>& batches) ABSL_LOCKS_EXCLUDED(mutex_);
  // Parses, traces and writes the reply of one batch. May end later, on another thread.
  void Answer(const BatchPointer& batch, Expected expected) ABSL_LOCKS_EXCLUDED(mutex_);
  void Complete(const BatchPointer& batch, const absl::Status& status, grpc::ByteBuffer reply)
      ABSL_LOCKS_EXCLUDED(mutex_);

  const RayBackend backend_;
  std::weak_ptr<StreamCall> weak_self_;

  grpc::ByteBuffer incoming_;                                                   // gRPC's while reading_
  grpc::ByteBuffer outgoing_;                                                   // gRPC's while writing_
  std::unique_ptr<BatchBudget::Share> incoming_share_ ABSL_GUARDED_BY(mutex_);  // of the message that is next
  std::unique_ptr<BatchBudget::Share> outgoing_share_ ABSL_GUARDED_BY(mutex_);
  uint64_t expected_bytes_ ABSL_GUARDED_BY(mutex_) = 0;  // that a batch takes, by those before; 0: none was read yet
  bool reading_ ABSL_GUARDED_BY(mutex_) = false;
  bool writing_ ABSL_GUARDED_BY(mutex_) = false;
  bool reads_ended_ ABSL_GUARDED_BY(mutex_) = false;  // nothing more will be read
  bool draining_ ABSL_GUARDED_BY(mutex_) = false;
  bool finding_ ABSL_GUARDED_BY(mutex_) = false;                  // the mesh is looked for on the disk
  std::shared_ptr<const Target> target_ ABSL_GUARDED_BY(mutex_);  // nullptr until the mesh was found
  std::deque<BatchPointer> line_ ABSL_GUARDED_BY(mutex_);
  uint64_t batches_read_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t batches_answered_ ABSL_GUARDED_BY(mutex_) = 0;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_STREAM_CALL_H_
