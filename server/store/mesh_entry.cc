#include "server/store/mesh_entry.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/store/build_memory.h"
#include "server/store/mesh_file.h"
#include "server/store/record_file.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

// A build may have failed for what passes: a disk that could not be read, memory that was short.
constexpr std::chrono::seconds kTryAgain{1};

// Whether reading a mesh's file has told that it is lost or damaged.
bool IsLost(const absl::Status& read) { return absl::IsDataLoss(read) || absl::IsNotFound(read); }

}  // namespace

MeshEntry::MeshEntry(MeshInfo info, std::string path, BuildQueue* queue, TreeBudget* budget)
    : info_(std::move(info)), path_(std::move(path)), queue_(queue), budget_(budget), config_(info_.config) {}

MeshInfo MeshEntry::Info() const {
  MeshInfo info = info_;
  MutexLock lock(mutex_);
  info.config = config_;
  if (current_) {
    BuildReport report = CurrentReport();
    info.state = report.state;
    info.failure = std::move(report.failure);
  }
  return info;
}

Config MeshEntry::config() const {
  MutexLock lock(mutex_);
  return config_;
}

bool MeshEntry::file_is_lost() const {
  MutexLock lock(mutex_);
  return file_is_lost_;
}

absl::StatusOr<bool> MeshEntry::CheckFile(const std::function<bool()>& cancelled) {
  const absl::Status read = CheckMeshFile(path_, id(), cancelled);
  const bool is_lost = IsLost(read);
  if (!read.ok() && !is_lost) return read;
  MutexLock lock(mutex_);
  file_is_lost_ = is_lost;
  return !is_lost;
}

void MeshEntry::Start(LoadedMesh loaded) {
  MutexLock lock(mutex_);
  if (!current_ || !current_->status().ok()) StartRun(std::move(loaded)).IgnoreError();
}

void MeshEntry::Rebuild(const Config& config, LoadedMesh loaded) {
  std::shared_ptr<BuildRun> old;
  {
    MutexLock lock(mutex_);
    config_ = config;
    old = ReplaceRun(std::move(loaded));
  }
  if (old) old->Cancel();
}

std::shared_ptr<BuildRun> MeshEntry::ReplaceRun(LoadedMesh loaded) {
  std::shared_ptr<BuildRun> old = current_;
  if (StartRun(std::move(loaded)).ok()) return old;
  // A mesh that is only stored is built with config_ anyway.
  rebuild_is_due_ = old != nullptr;
  return nullptr;
}

absl::Status MeshEntry::CheckRebuild(const Config& config) const {
  if (absl::Status status = CheckBuildFits(info_, config, *budget_); !status.ok()) return status;
  MutexLock lock(mutex_);
  return queue_->CheckRoom(current_ ? current_->number() : 0);
}

void MeshEntry::SetConfig(const Config& config) {
  std::shared_ptr<BuildRun> old;
  {
    MutexLock lock(mutex_);
    if (EncodeConfig(config) == EncodeConfig(config_)) return;
    config_ = config;
    if (current_) old = ReplaceRun();
  }
  if (old) old->Cancel();
}

std::shared_ptr<BuildRun> MeshEntry::StartDueRebuild() {
  return rebuild_is_due_ && queue_->CheckRoom(0).ok() ? ReplaceRun() : nullptr;
}

bool MeshEntry::WithTree(bool final, std::function<void(absl::StatusOr<MeshStore::Answer>)> callback,
                         std::function<bool()> cancelled) {
  absl::StatusOr<MeshStore::Answer> answer;
  std::shared_ptr<BuildRun> old;
  bool waits = false;
  Touch();
  {
    MutexLock lock(mutex_);
    old = StartDueRebuild();
    const std::shared_ptr<BuildRun>& run = final ? finished_ : answering_;
    if (!closed_.ok()) {
      answer = closed_;
    } else if (run) {
      answer = AnswerFrom(*run);
    } else if (current_ && !current_->status().ok() && !MayTryAgain()) {
      answer = BuildFailure(current_->status());
    } else if (!no_waiting_.ok()) {
      answer = no_waiting_;
    } else {
      absl::Status started;
      if (!current_ || !current_->status().ok()) started = StartRun();
      waits = started.ok();
      if (waits) {
        waiters_.push_back({final, std::move(callback), std::move(cancelled)});
      } else {
        answer = started;
      }
    }
  }
  if (old) old->Cancel();
  if (!waits) callback(std::move(answer));
  return waits;
}

void MeshEntry::ForgetCancelled() {
  std::vector<Waiter> forgotten;  // destroyed after the lock
  MutexLock lock(mutex_);
  const auto end = std::stable_partition(waiters_.begin(), waiters_.end(),
                                         [](const Waiter& w) { return !w.cancelled || !w.cancelled(); });
  forgotten.assign(std::make_move_iterator(end), std::make_move_iterator(waiters_.end()));
  waiters_.erase(end, waiters_.end());
}

bool MeshEntry::IsWaitedFor() const {
  MutexLock lock(mutex_);
  return !waiters_.empty();
}

void MeshEntry::StopWaiting(const absl::Status& status) {
  std::vector<Waiter> waiters;
  {
    MutexLock lock(mutex_);
    no_waiting_ = status;
    waiters.swap(waiters_);
  }
  for (Waiter& waiter : waiters) waiter.callback(status);
}

absl::StatusOr<BuildReport> MeshEntry::Watch(bool start) {
  std::shared_ptr<BuildRun> old;
  BuildReport report;
  {
    MutexLock lock(mutex_);
    old = StartDueRebuild();
    if (!current_ && start) {
      if (absl::Status status = StartRun(); !status.ok()) return status;
    }
    if (current_) report = CurrentReport();
    report.answers = answering_ != nullptr && closed_.ok();
  }
  if (old) old->Cancel();
  return report;
}

bool MeshEntry::MayTryAgain() const {
  return std::chrono::steady_clock::now() - failed_at_ >= kTryAgain || absl::IsNotFound(current_->status());
}

BuildReport MeshEntry::CurrentReport() const {
  BuildReport report;
  if (rebuild_is_due_) {
    report.state = MeshState::kBuilding;
    report.progress.triangles = info_.triangle_count;
    return report;
  }
  report = current_->Report();
  // The run has its trees a moment before they answer here, and what is said to stand must answer.
  if (report.state == MeshState::kReady && current_ != finished_) report.state = MeshState::kProvisional;
  if (report.state == MeshState::kProvisional && current_ != answering_) report.state = MeshState::kBuilding;
  return report;
}

absl::StatusOr<StoredStatistics> MeshEntry::Statistics() const {
  std::shared_ptr<BuildRun> run;
  {
    MutexLock lock(mutex_);
    run = answering_;
  }
  if (!run) {
    return absl::FailedPreconditionError(absl::StrCat(
        "no tree of mesh ", id(),
        " is in memory: none was built since the server started, or it had to make room; a watch has one built"));
  }
  return run->Statistics();
}

void MeshEntry::AddUsage(StoreUsage* usage) const {
  MutexLock lock(mutex_);
  ++usage->meshes[static_cast<size_t>(current_ ? CurrentReport().state : MeshState::kStored)];
  if (const std::shared_ptr<const TriangleMesh> mesh = mesh_.lock()) usage->mesh_bytes += mesh->Bytes();
  if (answering_) usage->tree_bytes += answering_->tree_bytes();
  if (finished_ && finished_ != answering_) usage->tree_bytes += finished_->tree_bytes();
}

bool MeshEntry::CurrentIsNeeded() const {
  // Its end is yet to be told to those who wait for it.
  return !current_ || !current_->has_ended() || !waiters_.empty();
}

std::vector<std::shared_ptr<TreeBudget::Reservation>> MeshEntry::DroppableMemory() const {
  std::vector<std::shared_ptr<TreeBudget::Reservation>> result;
  if (uploaded_.memory) result.push_back(uploaded_.memory);
  if (finished_) result.push_back(finished_->memory());
  if (answering_ && answering_ != finished_ && !(answering_ == current_ && CurrentIsNeeded())) {
    result.push_back(answering_->memory());
  }
  return result;
}

uint64_t MeshEntry::DroppableBytes() const {
  MutexLock lock(mutex_);
  uint64_t bytes = 0;
  for (const std::shared_ptr<TreeBudget::Reservation>& memory : DroppableMemory()) bytes += memory->bytes();
  return bytes;
}

std::string MeshEntry::Drop() {
  // Destroyed after the lock.
  LoadedMesh uploaded;
  std::shared_ptr<BuildRun> finished, answering, current;
  MutexLock lock(mutex_);
  for (const std::shared_ptr<TreeBudget::Reservation>& memory : DroppableMemory()) memory->Retire();
  uploaded = std::exchange(uploaded_, {});
  const bool keep_current = CurrentIsNeeded();
  finished = std::exchange(finished_, nullptr);
  if (answering_ && !(keep_current && answering_ == current_)) answering.swap(answering_);
  // A failure is remembered, but not what it has of a tree.
  if (!keep_current && current_->status().ok()) {
    current.swap(current_);
  } else if (!keep_current && answering == current_) {
    current_ = current_->WithoutTree();
  }
  rebuild_is_due_ = rebuild_is_due_ && current_;
  if (finished || answering) return "tree";
  return uploaded.mesh ? "geometry" : "";
}

void MeshEntry::Close(const absl::Status& status) {
  std::vector<Waiter> waiters;
  LoadedMesh uploaded;  // destroyed after the lock
  std::shared_ptr<BuildRun> run;
  {
    MutexLock lock(mutex_);
    closed_ = status;
    rebuild_is_due_ = false;
    uploaded = std::exchange(uploaded_, {});
    waiters.swap(waiters_);
    run = current_;
  }
  if (run) {
    queue_->Remove(run->number());
    run->Cancel();
  }
  for (Waiter& waiter : waiters) waiter.callback(status);
}

absl::Status MeshEntry::StartRun(LoadedMesh loaded) {
  if (!closed_.ok()) return absl::OkStatus();
  const auto run = std::make_shared<BuildRun>(queue_->NextNumber(), config_, info_.triangle_count);
  // Before a thread of the queue makes room for it.
  Touch();
  // A run that waits makes room for the one that takes its place.
  absl::Status status = queue_->Push(
      run->number(), [self = shared_from_this(), run] { self->DoRun(run); }, current_ ? current_->number() : 0);
  if (!status.ok()) return status;
  current_ = run;
  rebuild_is_due_ = false;
  if (loaded.mesh) uploaded_ = std::move(loaded);
  return absl::OkStatus();
}

void MeshEntry::DoRun(const std::shared_ptr<BuildRun>& run) {
  spdlog::info("build {} of mesh {} started", run->number(), id());
  const auto load = [&](const std::function<bool()>& cancelled) -> absl::StatusOr<std::shared_ptr<const TriangleMesh>> {
    auto memory = ReserveForBuild(info_, run->config(), budget_, cancelled);
    if (!memory.ok()) return memory.status();
    run->Hold(*std::move(memory));
    return LoadMesh(cancelled);
  };
  const absl::Status status = run->Run(load, queue_->options(), [&] { BecomeProvisional(run); });
  const double seconds = run->Report().progress.elapsed_seconds;
  if (status.ok()) {
    spdlog::info("build {} of mesh {} ended after {:.3f} s", run->number(), id(), seconds);
  } else if (absl::IsCancelled(status)) {
    spdlog::info("build {} of mesh {} was cancelled after {:.3f} s", run->number(), id(), seconds);
  } else if (absl::IsNotFound(status)) {
    spdlog::info("build {} of mesh {} ended: it was deleted", run->number(), id());
  } else {
    spdlog::error("build {} of mesh {} failed: {}", run->number(), id(), status.ToString());
  }
  End(run, status);
  if (queue_->on_build_end()) queue_->on_build_end()(run->Ended(id()));
}

absl::StatusOr<std::shared_ptr<const TriangleMesh>> MeshEntry::LoadMesh(const std::function<bool()>& cancelled) {
  {
    LoadedMesh uploaded;  // what it takes is the run's from here on
    MutexLock lock(mutex_);
    uploaded = std::exchange(uploaded_, {});
    if (uploaded.mesh) mesh_ = uploaded.mesh;
    if (std::shared_ptr<const TriangleMesh> mesh = mesh_.lock()) return mesh;
  }
  absl::StatusOr<TriangleMesh> read = ReadMeshFile(path_, id(), cancelled);
  const auto mesh = read.ok() ? std::make_shared<const TriangleMesh>(*std::move(read)) : nullptr;

  MutexLock lock(mutex_);
  file_is_lost_ = IsLost(read.status());
  if (!mesh) return read.status();
  mesh_ = mesh;
  return mesh;
}

void MeshEntry::BecomeProvisional(const std::shared_ptr<BuildRun>& run) {
  std::vector<Waiter> ready;
  std::shared_ptr<BuildRun> old;  // destroyed after the lock
  {
    MutexLock lock(mutex_);
    if (run != current_ || !closed_.ok()) return;
    old = std::exchange(answering_, run);
    const auto begin = std::stable_partition(waiters_.begin(), waiters_.end(), [](const Waiter& w) { return w.final; });
    ready.assign(std::make_move_iterator(begin), std::make_move_iterator(waiters_.end()));
    waiters_.erase(begin, waiters_.end());
  }
  for (Waiter& waiter : ready) waiter.callback(AnswerFrom(*run));
}

void MeshEntry::End(const std::shared_ptr<BuildRun>& run, const absl::Status& status) {
  std::vector<Waiter> waiters;
  std::shared_ptr<BuildRun> old;  // destroyed after the lock
  {
    MutexLock lock(mutex_);
    // Those who wait for a run that was cancelled by Rebuild wait for the one that came after it.
    if (run != current_ || !closed_.ok()) return;
    if (!status.ok()) failed_at_ = std::chrono::steady_clock::now();
    if (status.ok()) {
      old = std::exchange(finished_, run);
    } else if (finished_) {
      old = std::exchange(answering_, finished_);
      current_ = run->WithoutTree();
    }
    waiters.swap(waiters_);
  }
  for (Waiter& waiter : waiters) {
    if (status.ok()) {
      waiter.callback(AnswerFrom(*run));
    } else {
      waiter.callback(BuildFailure(status));
    }
  }
}

MeshStore::Answer MeshEntry::AnswerFrom(const BuildRun& run) const {
  return {id(), run.snapshot(), run.first_answer()};
}

absl::Status MeshEntry::BuildFailure(const absl::Status& status) const {
  // Another server has deleted it, which the store is about to notice.
  if (absl::IsNotFound(status)) return absl::NotFoundError(absl::StrCat("mesh ", id(), " was deleted"));
  const std::string text = absl::StrCat("the build of mesh ", id(), " failed: ", status.message());
  if (absl::IsDataLoss(status)) return absl::DataLossError(text);
  if (absl::IsResourceExhausted(status)) return absl::ResourceExhaustedError(text);
  return absl::FailedPreconditionError(text);
}

}  // namespace deltaray
