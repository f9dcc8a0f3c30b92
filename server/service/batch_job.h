// One batch on its way from the request to its reply.

#ifndef SERVER_SERVICE_BATCH_JOB_H_
#define SERVER_SERVICE_BATCH_JOB_H_

#include <functional>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "grpcpp/support/slice.h"
#include "server/service/batch_answer.h"
#include "server/service/batch_budget.h"
#include "server/service/batch_query.h"
#include "server/service/metrics.h"
#include "server/service/ray_message.h"
#include "server/service/tracer.h"
#include "server/service/worker_pool.h"
#include "server/store/mesh_store.h"

namespace deltaray {

// What answers batches; all of it outlives every call.
struct RayBackend {
  MeshStore* store;
  WorkerPool* disk;  // looks for meshes that are not known
  Tracer* tracer;
  BatchLimits limits;
  BatchBudget* budget;
  Metrics* metrics;
};

// Calls `use` with the best tree of the mesh that there is, or as soon as there is one (with `wait_final`, the final
// one), or with why there is none; not at all where the server ends first, or where `cancelled`, asked from any thread,
// says that nobody waits any more. It must not throw, and all calls but the first one are to be ignored.
//
// Where there is a tree already, of a mesh that is known, `use` runs on the calling thread, else with a tree on one of
// the tracer. Must not be called with a lock held that `use` takes.
void UseTree(const RayBackend& backend, const std::string& mesh, bool wait_final, std::function<bool()> cancelled,
             std::function<void(absl::StatusOr<MeshStore::Answer>)> use);

struct BatchJob {
  struct Answer {
    std::string mesh_id;
    grpc::Slice hits;  // a v1::HitBatch
  };

  std::string mesh;  // id or name
  BatchQuery query;
  RayBatchBytes rays;
  std::shared_ptr<BatchMeter> meter;
  // Whether the answer is not wanted any more. Asked from any thread.
  std::function<bool()> cancelled;
  // Called from any thread, with no lock held; not at all where the server ends first, or where it was cancelled while
  // it waited for a tree. Must not throw. All calls but the first one are to be ignored.
  std::function<void(absl::StatusOr<Answer>)> done;
};

// Answers the batch from the best tree that there is, or as soon as there is one.
//
// Where a tree is there already, traces on the calling thread: that must be a thread of the tracer, unless
// IsSmall. What takes longer than such a batch should goes on as a task of the tracer. Must not be called with a lock
// held that job->done takes.
void RunBatch(const RayBackend& backend, std::shared_ptr<BatchJob> job);

}  // namespace deltaray

#endif  // SERVER_SERVICE_BATCH_JOB_H_
