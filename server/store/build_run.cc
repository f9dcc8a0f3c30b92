#include "server/store/build_run.h"

#include <new>
#include <utility>

#include "server/build/thread_cpu.h"
#include "server/tree/large_memory.h"

namespace deltaray {
namespace {

double SecondsSince(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

uint64_t TreeBytes(const Tree& tree) {
  const TreeShape shape = tree.Shape();
  return ResidentBytes(shape.node_bytes + shape.reference_bytes);
}

}  // namespace

absl::Status BuildRun::Run(const LoadMesh& load, const Build::Options& options,
                           const std::function<void()>& on_provisional) {
  absl::Status status;
  try {
    status = LoadAndBuild(load, options, on_provisional);
  } catch (const std::bad_alloc&) {
    // What was there of it no longer counts as being built.
    if (const std::shared_ptr<Build> running = build()) {
      running->Cancel();
      running->WaitDone().IgnoreError();
    }
    status = absl::ResourceExhaustedError("no memory to build the tree");
  }
  if (status.ok()) {
    const TreeShape shape = build()->statistics().shape;
    tree_bytes_ = shape.node_bytes + shape.reference_bytes;
  }
  // Where it failed after its provisional tree stood, that goes on to answer.
  if (const std::shared_ptr<Build> failed = status.ok() ? nullptr : build();
      failed && failed->snapshot() && !failed->snapshot()->tree->is_growing()) {
    try {
      HoldTree(0);
    } catch (const std::bad_alloc&) {
      // It keeps what it has.
    }
  }
  const BuildProgress last_progress = Report().progress;
  // Destroyed, after the lock and in this order, where nothing is to be had from the build.
  std::shared_ptr<TreeBudget::Reservation> memory;
  std::shared_ptr<Build> dropped;
  MutexLock lock(mutex_);
  ended_ = true;
  status_ = status;
  last_progress_ = last_progress;
  if (!status.ok() && build_ && !build_->snapshot()) dropped.swap(build_);
  if (!build_) memory.swap(memory_);
  return status;
}

std::shared_ptr<BuildRun> BuildRun::WithoutTree() const {
  const auto run = std::make_shared<BuildRun>(number_, config_, triangles_);
  MutexLock lock(mutex_);
  MutexLock run_lock(run->mutex_);
  run->begun_ = begun_, run->begin_ = begin_;
  run->ended_ = ended_, run->status_ = status_, run->last_progress_ = last_progress_;
  return run;
}

absl::Status BuildRun::LoadAndBuild(const LoadMesh& load, Build::Options options,
                                    const std::function<void()>& on_provisional) {
  const auto begin = std::chrono::steady_clock::now();
  const int64_t cpu_begin = ThreadCpuNanoseconds();
  {
    MutexLock lock(mutex_);
    begun_ = true;
    begin_ = begin;
  }
  first_answer_->Begin();

  if (cancelled_) return absl::CancelledError("the build was cancelled");
  absl::StatusOr<std::shared_ptr<const TriangleMesh>> mesh = load([this] { return cancelled_.load(); });
  if (!mesh.ok()) return mesh.status();

  options.config = config_;
  const double load_cpu = 1e-9 * static_cast<double>(ThreadCpuNanoseconds() - cpu_begin);
  const std::shared_ptr<Build> build = Build::Start(*std::move(mesh), std::move(options));
  {
    MutexLock lock(mutex_);
    // All that is not the build's own, so that elapsed time goes on where it was. The sum must not fall behind what was
    // reported before: the build's clock is read first, and nobody reports meanwhile. A small build may be over by now.
    const double build_wall = build->progress().elapsed_seconds;
    load_ = {BuildPhase::kReferences, SecondsSince(begin) - build_wall, load_cpu};
    build_ = build;
  }
  // A Cancel that came before build_ was set did not reach it.
  if (cancelled_) build->Cancel();

  if (absl::Status status = build->WaitProvisional(); !status.ok()) return status;
  const uint64_t provisional_bytes = TreeBytes(*build->snapshot()->tree);
  on_provisional();
  if (absl::Status status = build->WaitDone(); !status.ok()) return status;
  // A lazy tree grows until all of it is built, unnoticed.
  if (!build->snapshot()->tree->is_growing()) HoldTree(provisional_bytes);
  return absl::OkStatus();
}

void BuildRun::Hold(std::shared_ptr<TreeBudget::Reservation> memory) {
  MutexLock lock(mutex_);
  memory_ = std::move(memory);
}

void BuildRun::HoldTree(uint64_t provisional_bytes) {
  const std::shared_ptr<const TreeSnapshot> tree = build()->snapshot();
  // Before the lock: it looks at the whole tree.
  const uint64_t final_bytes = TreeBytes(*tree->tree) + tree->mesh->Bytes();
  std::shared_ptr<TreeBudget::Reservation> building;
  {
    MutexLock lock(mutex_);
    building = std::exchange(memory_, memory_->Split(final_bytes));
  }
  // Batches may hold the provisional tree for longer, and this with it. After the lock: memory goes to the system.
  building->ShrinkTo(provisional_bytes);
}

void BuildRun::Cancel() {
  cancelled_ = true;
  if (const std::shared_ptr<Build> running = build()) running->Cancel();
}

std::shared_ptr<Build> BuildRun::build() const {
  MutexLock lock(mutex_);
  return build_;
}

bool BuildRun::has_ended() const {
  MutexLock lock(mutex_);
  return ended_;
}

absl::Status BuildRun::status() const {
  MutexLock lock(mutex_);
  return status_;
}

std::shared_ptr<const TreeSnapshot> BuildRun::snapshot() const {
  struct Held {
    std::shared_ptr<TreeBudget::Reservation> memory;  // given back after the tree is gone
    std::shared_ptr<const TreeSnapshot> tree;
  };
  auto held = std::make_shared<Held>();
  MutexLock lock(mutex_);
  if (build_) held->tree = build_->snapshot();
  held->memory = memory_;
  return {held, held->tree.get()};
}

std::shared_ptr<TreeBudget::Reservation> BuildRun::memory() const {
  MutexLock lock(mutex_);
  return memory_;
}

BuildReport BuildRun::Report() const {
  BuildReport report;
  report.build_number = number_;
  report.progress.triangles = triangles_;
  std::shared_ptr<Build> running;
  {
    MutexLock lock(mutex_);
    running = build_;
    if (!running && ended_) {
      report.progress = last_progress_;
    } else if (!running && begun_) {
      report.progress.phase = BuildPhase::kReferences;
      report.progress.elapsed_seconds = SecondsSince(begin_);
    }
  }
  if (running) report.progress = running->progress();
  const std::shared_ptr<const TreeSnapshot> tree = running ? running->snapshot() : nullptr;

  MutexLock lock(mutex_);
  // A lazy build has ended long before all of its δ-leaves are built.
  const bool ready = report.progress.lazy ? ended_ && report.progress.delta_leaves_built == report.progress.delta_leaves
                                          : tree && tree->final;
  if (!status_.ok()) {
    report.state = MeshState::kFailed;
  } else if (!tree) {
    report.state = MeshState::kBuilding;
  } else {
    report.state = ready ? MeshState::kReady : MeshState::kProvisional;
  }
  report.failure = std::string(status_.message());
  if (running) report.progress.elapsed_seconds += load_.wall_seconds;
  return report;
}

EndedBuild BuildRun::Ended(const std::string& mesh_id) const {
  EndedBuild ended{.mesh_id = mesh_id, .status = status(), .seconds = Report().progress.elapsed_seconds};
  if (build() != nullptr && snapshot() != nullptr) {
    BuildStatistics statistics = Statistics().statistics;
    ended.phases = std::move(statistics.phases);
    ended.delta_leaves_built = statistics.delta_leaves_built;
  }
  return ended;
}

StoredStatistics BuildRun::Statistics() const {
  StoredStatistics result;
  const std::shared_ptr<Build> running = build();
  result.build_number = number_;
  result.first_answer_seconds = first_answer_->seconds();
  result.statistics = running->statistics();
  result.mesh_bytes = running->snapshot()->mesh->Bytes();

  MutexLock lock(mutex_);
  for (PhaseTime& time : result.statistics.phases) {
    if (time.phase != load_.phase) continue;
    time.wall_seconds += load_.wall_seconds;
    time.cpu_seconds += load_.cpu_seconds;
  }
  if (result.statistics.provisional_seconds > 0) result.statistics.provisional_seconds += load_.wall_seconds;
  if (result.statistics.total_seconds > 0) result.statistics.total_seconds += load_.wall_seconds;
  return result;
}

}  // namespace deltaray
