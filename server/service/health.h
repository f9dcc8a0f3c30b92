// What is told of the server's health, and who is told.

#ifndef SERVER_SERVICE_HEALTH_H_
#define SERVER_SERVICE_HEALTH_H_

#include <atomic>
#include <string>

#include "absl/strings/string_view.h"
#include "grpc/health/v1/health.grpc.pb.h"
#include "server/service/batch_budget.h"
#include "server/service/calls.h"
#include "server/service/worker_pool.h"
#include "server/store/mesh_store.h"

namespace deltaray {

// Healths of the server, of each of its services and of each mesh, by the names of grpc.health.v1: "", a service's full
// name, "mesh/" and an id or a name. Thread-safe.
class Health {
 public:
  using Status = grpc::health::v1::HealthCheckResponse::ServingStatus;

  // `store` outlives this.
  explicit Health(MeshStore* store) : store_(store) {}

  // SERVICE_UNKNOWN where no such service or mesh is known. A mesh is SERVING while rays on it are answered without
  // waiting; one without a tree has its build started, for nobody would ask a mesh that waits for a first query.
  Status Of(absl::string_view service) const;
  // The same, but looks on the disk for a mesh that is not known, which blocks; whether it would.
  Status Find(absl::string_view service) const;
  bool FindBlocks(absl::string_view service) const;

  // From now on everything known is NOT_SERVING.
  void Drain() { draining_ = true; }

  static bool IsMesh(absl::string_view service);

 private:
  MeshStore* const store_;
  std::atomic<bool> draining_{false};
};

// The RPCs of grpc.health.v1.Health. Thread-safe.
//
// The server and its services are for whoever asks, load balancers without a token too; calls about a mesh are admitted
// as others are, as Health/Check and Health/Watch.
class HealthHandlers final
    : public grpc::health::v1::Health::WithRawCallbackMethod_Check<
          grpc::health::v1::Health::WithRawCallbackMethod_Watch<grpc::health::v1::Health::Service>> {
 public:
  // Watches at once. Each client that checks health holds one a connection.
  static constexpr size_t kMaxWatches = 4096;

  // All outlive the handlers. Meshes that are not known are looked for on `disk`; replies take of `budget`.
  HealthHandlers(Calls* calls, MeshStore* store, WorkerPool* disk, BatchBudget* budget)
      : calls_(calls), health_(store), disk_(disk), budget_(budget) {}

  grpc::ServerUnaryReactor* Check(grpc::CallbackServerContext* context, const grpc::ByteBuffer* request,
                                  grpc::ByteBuffer* response) override;
  grpc::ServerWriteReactor<grpc::ByteBuffer>* Watch(grpc::CallbackServerContext* context,
                                                    const grpc::ByteBuffer* request) override;

  // Watches are told NOT_SERVING and end; checks of the server and its services go on.
  void Drain();

 private:
  Calls* const calls_;
  Health health_;
  WorkerPool* const disk_;
  BatchBudget* const budget_;
  std::atomic<size_t> watch_count_{0};
  Calls watches_;  // those that are not among calls_
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_HEALTH_H_
