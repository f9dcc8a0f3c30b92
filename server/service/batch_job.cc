#include "server/service/batch_job.h"

#include <atomic>
#include <thread>
#include <utility>

#include "server/service/rpc_status.h"

namespace deltaray {
namespace {

void Trace(const RayBackend& backend, BatchJob& job, const MeshStore::Answer& tree) {
  BatchJob::Answer answer;
  // Between two pieces, batches that take less long get their turn; not on threads of gRPC, where small ones are
  // traced.
  const bool on_tracer = !IsSmall(job.query, job.rays.rays.size);
  const std::function<bool()> cancelled = [&] {
    if (on_tracer) backend.tracer->RunShort();
    return job.cancelled();
  };
  const absl::Status status = CatchExceptions([&] {
    job.meter->BeginTracing();
    absl::StatusOr<BatchAnswer> traced = AnswerBatch(*tree.snapshot, job.query, job.rays, backend.limits, cancelled);
    if (!traced.ok()) return traced.status();
    backend.store->NoteAnswer(tree);
    job.meter->CountAnswer({tree.id, job.query.kind, traced->accuracy, traced->ray_count, traced->hit_count});
    answer = {tree.id, std::move(traced->hits)};
    return absl::OkStatus();
  });
  if (status.ok()) {
    job.done(std::move(answer));
  } else {
    job.done(status);
  }
}

}  // namespace

void UseTree(const RayBackend& backend, const std::string& mesh, bool wait_final, std::function<bool()> cancelled,
             std::function<void(absl::StatusOr<MeshStore::Answer>)> use) {
  // Whether WithTree has returned: a thread of the tracer may come back later as one of a build.
  const auto returned = std::make_shared<std::atomic<bool>>(false);
  const auto on_tree = [backend, use, returned,
                        caller = std::this_thread::get_id()](absl::StatusOr<MeshStore::Answer> tree) {
    const bool here = std::this_thread::get_id() == caller && !*returned;
    if (!tree.ok() || (here && !tree->snapshot->tree->is_growing())) {
      use(std::move(tree));
      return;
    }
    // Not on a thread of a build, which must not be held up, nor get exceptions; nor on one of gRPC, where a tree that
    // grows takes too long for a small batch.
    const absl::Status status = CatchExceptions([&] {
      backend.tracer->Enqueue([use, tree = *std::move(tree)] { use(tree); });
      return absl::OkStatus();
    });
    if (!status.ok()) use(status);
  };
  const absl::Status status = CatchExceptions([&] {
    backend.store->WithTree(mesh, wait_final, on_tree, std::move(cancelled));
    *returned = true;
    return absl::OkStatus();
  });
  if (!status.ok()) use(status);
}

void RunBatch(const RayBackend& backend, std::shared_ptr<BatchJob> job) {
  const auto cancelled = [job] { return job->cancelled(); };
  UseTree(backend, job->mesh, job->query.wait_final, cancelled, [backend, job](absl::StatusOr<MeshStore::Answer> tree) {
    if (tree.ok()) {
      Trace(backend, *job, *tree);
    } else {
      job->done(tree.status());
    }
  });
}

}  // namespace deltaray
