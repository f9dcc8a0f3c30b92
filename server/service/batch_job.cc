#include "server/service/batch_job.h"

#include <atomic>
#include <chrono>
#include <optional>
#include <thread>
#include <utility>

#include "server/service/rpc_status.h"

namespace deltaray {
namespace {

using Clock = std::chrono::steady_clock;

// What the size of a batch promises of its time. Each keeps others waiting for as long as that only, however slow its
// rays are.
enum class Expected : uint8_t {
  kSmall,  // at most 10 ms, on a thread of gRPC
  kShort,  // at most 100 ms, before batches that take long
  kLong,
};

Expected ExpectedOf(const BatchJob& job, const Tree& tree) {
  if (tree.is_growing()) return Expected::kLong;
  const size_t bytes = job.rays.rays.size;
  return IsSmall(job.query, bytes) ? Expected::kSmall : IsShort(job.query, bytes) ? Expected::kShort : Expected::kLong;
}

Clock::time_point EndOf(Expected expected) {
  switch (expected) {
    case Expected::kSmall:
      return Clock::now() + std::chrono::milliseconds(10);
    case Expected::kShort:
      return Clock::now() + std::chrono::milliseconds(100);
    case Expected::kLong:
      break;
  }
  return Clock::time_point::max();
}

// One that takes longer than expected begins anew as a long one, on the tracer.
void Trace(const RayBackend& backend, const std::shared_ptr<BatchJob>& job, const MeshStore::Answer& tree,
           Expected expected) {
  std::optional<BatchJob::Answer> answer;
  const Clock::time_point end = EndOf(expected);
  const auto is_late = [end] { return end != Clock::time_point::max() && Clock::now() > end; };
  // Between two slices, batches that take less long get their turn; not on threads of gRPC, where small ones are
  // traced.
  const BatchControl control{[&] { return job->cancelled() || is_late(); },
                             [&] {
                               if (expected != Expected::kSmall) backend.tracer->RunShort();
                             }};
  const absl::Status status = CatchExceptions([&] {
    job->meter->BeginTracing();
    absl::StatusOr<BatchAnswer> traced = AnswerBatch(*tree.snapshot, job->query, job->rays, backend.limits, control);
    if (absl::IsCancelled(traced.status()) && !job->cancelled()) {
      backend.tracer->Enqueue([backend, job, tree] { Trace(backend, job, tree, Expected::kLong); });
      return absl::OkStatus();
    }
    if (!traced.ok()) return traced.status();
    backend.store->NoteAnswer(tree);
    job->meter->CountAnswer({tree.id, job->query.kind, traced->accuracy, traced->ray_count, traced->hit_count});
    answer = {tree.id, std::move(traced->hits)};
    return absl::OkStatus();
  });
  if (!status.ok()) {
    job->done(status);
  } else if (answer.has_value()) {
    job->done(*std::move(answer));
  }
}

// UseTree of a mesh that is known.
void UseTreeOfKnown(const RayBackend& backend, const std::string& mesh, bool wait_final,
                    std::function<bool()> cancelled, std::function<void(absl::StatusOr<MeshStore::Answer>)> use) {
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

}  // namespace

void UseTree(const RayBackend& backend, const std::string& mesh, bool wait_final, std::function<bool()> cancelled,
             std::function<void(absl::StatusOr<MeshStore::Answer>)> use) {
  if (backend.store->IsKnown(mesh)) {
    return UseTreeOfKnown(backend, mesh, wait_final, std::move(cancelled), std::move(use));
  }
  const auto find = [backend, mesh, wait_final, cancelled, use] {
    if (cancelled()) return;
    const absl::Status status = CatchExceptions([&] {
      // Known from here on, where it is there.
      if (absl::Status found = backend.store->Resolve(mesh).status(); !found.ok()) return found;
      backend.tracer->Enqueue([=] { UseTreeOfKnown(backend, mesh, wait_final, cancelled, use); });
      return absl::OkStatus();
    });
    if (!status.ok()) use(status);
  };
  const absl::Status status = CatchExceptions([&] {
    backend.disk->Run(find);
    return absl::OkStatus();
  });
  if (!status.ok()) use(status);
}

void RunBatch(const RayBackend& backend, std::shared_ptr<BatchJob> job) {
  const auto cancelled = [job] { return job->cancelled(); };
  UseTree(backend, job->mesh, job->query.wait_final, cancelled, [backend, job](absl::StatusOr<MeshStore::Answer> tree) {
    if (tree.ok()) {
      Trace(backend, job, *tree, ExpectedOf(*job, *tree->snapshot->tree));
    } else {
      job->done(tree.status());
    }
  });
}

}  // namespace deltaray
