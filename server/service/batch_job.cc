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

// After it, a batch keeps others waiting.
Clock::duration PatienceWith(Expected expected) {
  switch (expected) {
    case Expected::kSmall:
      return std::chrono::milliseconds(5);
    case Expected::kShort:
      return std::chrono::milliseconds(100);
    case Expected::kLong:
      break;
  }
  return Clock::duration::max();
}

// One that takes longer than expected begins anew on the tracer, as one that takes longer.
void Trace(const RayBackend& backend, const std::shared_ptr<BatchJob>& job, const MeshStore::Answer& tree,
           Expected expected) {
  std::optional<BatchJob::Answer> answer;
  const Clock::time_point begin = Clock::now();
  const Clock::duration patience = PatienceWith(expected);
  const auto is_late = [&] { return expected != Expected::kLong && Clock::now() - begin > patience; };
  // Between two slices of a batch that takes long, those that take less long get their turn.
  const auto pause = [&] {
    if (expected == Expected::kLong) backend.tracer->RunShort();
  };
  const BatchControl control{[&] { return job->cancelled() || is_late(); }, pause};
  const absl::Status status = CatchExceptions([&] {
    job->meter->BeginTracing();
    absl::StatusOr<BatchAnswer> traced = AnswerBatch(*tree.snapshot, job->query, job->rays, backend.limits, control);
    if (absl::IsCancelled(traced.status()) && !job->cancelled()) {
      const Expected next = expected == Expected::kSmall ? Expected::kShort : Expected::kLong;
      RunWhereExpected(*backend.tracer, next, [backend, job, tree, next] { Trace(backend, job, tree, next); });
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
                    std::function<bool()> cancelled, TreeUse use) {
  // Whether WithTree has returned: a thread of the tracer may come back later as one of a build.
  const auto returned = std::make_shared<std::atomic<bool>>(false);
  const auto on_tree = [backend, use, returned,
                        caller = std::this_thread::get_id()](absl::StatusOr<MeshStore::Answer> tree) {
    const bool here = std::this_thread::get_id() == caller && !*returned;
    if (!tree.ok() || (here && !tree->snapshot->tree->is_growing())) {
      use(std::move(tree), here);
      return;
    }
    // Not on a thread of a build, which must not be held up, nor get exceptions; nor on one of gRPC, where a tree that
    // grows takes too long for a small batch.
    const absl::Status status = CatchExceptions([&] {
      backend.tracer->Enqueue([use, tree = *std::move(tree)] { use(tree, false); });
      return absl::OkStatus();
    });
    if (!status.ok()) use(status, false);
  };
  const absl::Status status = CatchExceptions([&] {
    backend.store->WithTree(mesh, wait_final, on_tree, std::move(cancelled));
    *returned = true;
    return absl::OkStatus();
  });
  if (!status.ok()) use(status, true);
}

}  // namespace

Expected ExpectedOf(const BatchQuery& query, size_t bytes) {
  return IsSmall(query, bytes) ? Expected::kSmall : IsShort(query, bytes) ? Expected::kShort : Expected::kLong;
}

void RunWhereExpected(Tracer& tracer, Expected expected, std::function<void()> answer) {
  switch (expected) {
    case Expected::kSmall:
      return answer();
    case Expected::kShort:
      return tracer.EnqueueShort(std::move(answer));
    case Expected::kLong:
      return tracer.Enqueue(std::move(answer));
  }
}

void UseTree(const RayBackend& backend, const std::string& mesh, bool wait_final, std::function<bool()> cancelled,
             TreeUse use) {
  if (backend.store->IsKnown(mesh)) {
    return UseTreeOfKnown(backend, mesh, wait_final, std::move(cancelled), std::move(use));
  }
  const auto find = [backend, mesh, wait_final, cancelled, use] {
    const absl::Status status = CatchExceptions([&] {
      // Known from here on, where it is there.
      if (absl::Status found = backend.store->Resolve(mesh).status(); !found.ok()) return found;
      const TreeUse later = [use](absl::StatusOr<MeshStore::Answer> tree, bool) { use(std::move(tree), false); };
      backend.tracer->Enqueue([=] { UseTreeOfKnown(backend, mesh, wait_final, cancelled, later); });
      return absl::OkStatus();
    });
    if (!status.ok()) use(status, false);
  };
  const absl::Status status = CatchExceptions([&] {
    backend.disk->Run(find, cancelled);
    return absl::OkStatus();
  });
  if (!status.ok()) use(status, true);
}

void RunBatch(const RayBackend& backend, std::shared_ptr<BatchJob> job) {
  const auto cancelled = [job] { return job->cancelled(); };
  const auto trace = [backend, job](absl::StatusOr<MeshStore::Answer> tree, bool in_place) {
    if (!tree.ok()) return job->done(tree.status());
    Trace(backend, job, *tree, in_place ? job->expected : Expected::kLong);
  };
  UseTree(backend, job->mesh, job->query.wait_final, cancelled, trace);
}

}  // namespace deltaray
