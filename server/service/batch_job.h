// One batch on its way from the request to its reply.

#ifndef SERVER_SERVICE_BATCH_JOB_H_
#define SERVER_SERVICE_BATCH_JOB_H_

#include <cstdint>
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
// Where there is a tree already, of a mesh that is known, `use` runs in place, on the calling thread, else with a tree
// on one of the tracer, in the line of what takes long. Must not be called with a lock held that `use` takes.
using TreeUse = std::function<void(absl::StatusOr<MeshStore::Answer>, bool in_place)>;
void UseTree(const RayBackend& backend, const std::string& mesh, bool wait_final, std::function<bool()> cancelled,
             TreeUse use);

// What the size of a batch promises of its time. It keeps others waiting for as long as that only, however slow its
// rays are.
enum class Expected : uint8_t {
  kSmall,  // 5 ms, on a thread of gRPC
  kShort,  // 100 ms, before batches that take long
  kLong,
};

// Of a batch in a message of `bytes`.
Expected ExpectedOf(const BatchQuery& query, size_t bytes);

// Runs `answer`, which answers such a batch, where that belongs: here, or soon on a thread of the tracer.
void RunWhereExpected(Tracer& tracer, Expected expected, std::function<void()> answer);

struct BatchJob {
  struct Answer {
    std::string mesh_id;
    grpc::Slice hits;  // a v1::HitBatch
  };

  std::string mesh;  // id or name
  BatchQuery query;
  RayBatchBytes rays;
  Expected expected = Expected::kLong;  // by which it was brought where it runs
  std::shared_ptr<BatchMeter> meter;
  // Whether the answer is not wanted any more. Asked from any thread.
  std::function<bool()> cancelled;
  // Called from any thread, with no lock held; not at all where the server ends first, or where it was cancelled while
  // it waited for a tree. Must not throw. All calls but the first one are to be ignored.
  std::function<void(absl::StatusOr<Answer>)> done;
};

// Answers the batch from the best tree that there is, or as soon as there is one.
//
// Where a tree is there already, traces on the calling thread: that must be a thread of the tracer, unless kSmall is
// expected. What takes longer than expected is begun anew as a task of the tracer. Must not be called with a lock held
// that job->done takes.
void RunBatch(const RayBackend& backend, std::shared_ptr<BatchJob> job);

}  // namespace deltaray

#endif  // SERVER_SERVICE_BATCH_JOB_H_
