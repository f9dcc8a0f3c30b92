// One call of MeshService.WatchBuild.

#ifndef SERVER_SERVICE_WATCH_CALL_H_
#define SERVER_SERVICE_WATCH_CALL_H_

#include <memory>
#include <string>

#include "deltaray/v1/mesh_service.pb.h"
#include "grpcpp/alarm.h"
#include "grpcpp/support/byte_buffer.h"
#include "grpcpp/support/server_callback.h"
#include "server/service/call_reactor.h"
#include "server/service/worker_pool.h"
#include "server/store/mesh_store.h"

namespace deltaray {

// Looks at the build ten times a second, and writes what has changed since the last report. A client that takes its
// reports slowly gets fewer, never old ones.
class WatchCall final : public CallReactor<grpc::ServerWriteReactor<grpc::ByteBuffer>> {
 public:
  // Takes over a call: the reactor to give to gRPC.
  static grpc::ServerWriteReactor<grpc::ByteBuffer>* Start(Calls* calls, const RpcInfo& rpc, MeshStore* store,
                                                           WorkerPool* disk, const grpc::ByteBuffer* request);

  WatchCall(Calls* calls, MeshStore* store, WorkerPool* disk) : CallReactor(calls), store_(store), disk_(disk) {}

 private:
  void OnWriteDone(bool ok) override;
  void OnDrain() override;

  absl::Status ReadRequest(const grpc::ByteBuffer& request) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Looks at the build, and sets the alarm for the next look. A mesh that is not known is looked for on the disk first.
  void Look() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void LookOnDisk() ABSL_LOCKS_EXCLUDED(mutex_);
  void LookAt(const absl::StatusOr<std::string>& id) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::Status Report() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Whether a build in this state needs no further report.
  bool IsOver(const BuildReport& report) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  MeshStore* const store_;
  WorkerPool* const disk_;
  std::weak_ptr<WatchCall> weak_self_;
  // By id once it was found: the name may move.
  std::string mesh_ ABSL_GUARDED_BY(mutex_);
  grpc::ByteBuffer outgoing_;                       // gRPC's while writing_
  v1::BuildProgress last_ ABSL_GUARDED_BY(mutex_);  // without elapsed_seconds
  bool reported_ ABSL_GUARDED_BY(mutex_) = false;
  bool writing_ ABSL_GUARDED_BY(mutex_) = false;
  bool draining_ ABSL_GUARDED_BY(mutex_) = false;
  std::unique_ptr<grpc::Alarm> alarm_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_WATCH_CALL_H_
