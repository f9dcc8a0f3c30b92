// One call of MeshService.UploadMesh.

#ifndef SERVER_SERVICE_UPLOAD_CALL_H_
#define SERVER_SERVICE_UPLOAD_CALL_H_

#include <cstdint>
#include <memory>

#include "grpcpp/support/byte_buffer.h"
#include "grpcpp/support/server_callback.h"
#include "server/service/batch_budget.h"
#include "server/service/call_reactor.h"
#include "server/service/metrics.h"
#include "server/service/worker_pool.h"
#include "server/store/mesh_store.h"

namespace deltaray {

// What takes uploads; all of it outlives every call.
struct UploadBackend {
  MeshStore* store;
  WorkerPool* disk;     // writes chunks, looks for meshes
  WorkerPool* changes;  // names, deletes and rebuilds, which wait for the directory's lock
  WorkerPool* commits;  // reads the whole files as meshes: as many at a time as it has threads
  uint64_t max_upload_bytes;
  uint64_t max_message_bytes;  // of a reply
  BatchBudget* budget;         // of which replies take, until they are taken
  Metrics* metrics;
};

// Takes the messages one at a time: the next one is read once the one before is written. A message of a cancelled
// upload never becomes a mesh.
class UploadCall final : public CallReactor<grpc::ServerReadReactor<grpc::ByteBuffer>> {
 public:
  // Takes over a call: the reactor to give to gRPC. `response` belongs to gRPC.
  static grpc::ServerReadReactor<grpc::ByteBuffer>* Start(Calls* calls, const RpcInfo& rpc,
                                                          const UploadBackend& backend, grpc::ByteBuffer* response);

  UploadCall(Calls* calls, const UploadBackend& backend, grpc::ByteBuffer* response)
      : CallReactor(calls), backend_(backend), response_(response), reply_share_(backend.budget) {}

 private:
  void OnReadDone(bool ok) override;
  void OnSendInitialMetadataDone(bool ok) override;
  void OnDrain() override;
  void BeforeFinish() override ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  const char* MissingFromClient() const override ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    return reading_ ? "sent nothing" : nullptr;
  }

  void Read() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  // Runs `step`, which returns absl::Status, on `pool`, and finishes the call where it fails.
  template <typename Step>
  void RunStep(WorkerPool* pool, Step step);
  absl::Status TakeMessage();
  absl::Status Commit();

  const UploadBackend backend_;
  grpc::ByteBuffer* const response_;
  BatchBudget::Share reply_share_;
  std::weak_ptr<UploadCall> weak_self_;
  bool reading_ ABSL_GUARDED_BY(mutex_) = false;   // gRPC writes incoming_
  bool stepping_ ABSL_GUARDED_BY(mutex_) = false;  // a step uses it

  // Used by one step or reaction at a time; the reactions come in turns, and mutex_ is taken in between.
  grpc::ByteBuffer incoming_;
  uint64_t messages_ = 0;
  Upload::CommitOptions options_;
  std::unique_ptr<Upload> upload_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_UPLOAD_CALL_H_
