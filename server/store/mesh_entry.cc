#include "server/store/mesh_entry.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/store/mesh_file.h"
#include "spdlog/spdlog.h"

namespace deltaray {

MeshEntry::MeshEntry(MeshInfo info, std::string path, BuildQueue* queue)
    : groups_(std::exchange(info.groups, {})),
      info_(std::move(info)),
      path_(std::move(path)),
      queue_(queue),
      config_(info_.config) {}

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

void MeshEntry::Start(std::shared_ptr<const TriangleMesh> mesh) {
  MutexLock lock(mutex_);
  if (!current_ || !current_->status().ok()) StartRun(config_, std::move(mesh));
}

void MeshEntry::Rebuild(const Config& config, std::shared_ptr<const TriangleMesh> mesh) {
  std::shared_ptr<BuildRun> old;
  {
    MutexLock lock(mutex_);
    old = current_;
    config_ = config;
    StartRun(config, std::move(mesh));
  }
  if (old) old->Cancel();
}

void MeshEntry::WithTree(bool final, std::function<void(absl::StatusOr<MeshStore::Answer>)> callback) {
  absl::StatusOr<MeshStore::Answer> answer;
  {
    MutexLock lock(mutex_);
    const std::shared_ptr<BuildRun>& run = final ? finished_ : answering_;
    if (!closed_.ok()) {
      answer = closed_;
    } else if (run) {
      answer = AnswerFrom(*run);
    } else if (current_ && !current_->status().ok()) {
      answer = BuildFailure(current_->status());
    } else if (!no_waiting_.ok()) {
      answer = no_waiting_;
    } else {
      waiters_.push_back({final, std::move(callback)});
      if (!current_) StartRun(config_, nullptr);
      return;
    }
  }
  callback(std::move(answer));
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

BuildReport MeshEntry::Watch() {
  MutexLock lock(mutex_);
  if (!current_) StartRun(config_, nullptr);
  BuildReport report = current_ ? CurrentReport() : BuildReport();
  report.answers = answering_ != nullptr && closed_.ok();
  return report;
}

BuildReport MeshEntry::CurrentReport() const {
  BuildReport report = current_->Report();
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
    return absl::FailedPreconditionError(
        absl::StrCat("no tree of mesh ", id(), " was built yet since the server started"));
  }
  return run->Statistics();
}

void MeshEntry::AddUsage(StoreUsage* usage) const {
  MutexLock lock(mutex_);
  ++usage->meshes[static_cast<size_t>(current_ ? CurrentReport().state : MeshState::kStored)];
  usage->disk_bytes += info_.stored_bytes;
  if (const std::shared_ptr<const TriangleMesh> mesh = mesh_.lock()) usage->mesh_bytes += mesh->Bytes();
  if (answering_) usage->tree_bytes += answering_->tree_bytes();
  if (finished_ && finished_ != answering_) usage->tree_bytes += finished_->tree_bytes();
}

void MeshEntry::Close(const absl::Status& status) {
  std::vector<Waiter> waiters;
  std::shared_ptr<BuildRun> run;
  {
    MutexLock lock(mutex_);
    closed_ = status;
    uploaded_.reset();
    waiters.swap(waiters_);
    run = current_;
  }
  if (run) run->Cancel();
  for (Waiter& waiter : waiters) waiter.callback(status);
}

void MeshEntry::StartRun(const Config& config, std::shared_ptr<const TriangleMesh> mesh) {
  if (!closed_.ok()) return;
  if (mesh) uploaded_ = std::move(mesh);
  current_ = std::make_shared<BuildRun>(queue_->NextNumber(), config, info_.triangle_count);
  queue_->Push([self = shared_from_this(), run = current_] { self->DoRun(run); });
}

void MeshEntry::DoRun(const std::shared_ptr<BuildRun>& run) {
  spdlog::info("build {} of mesh {} started", run->number(), id());
  const auto load = [this](const std::function<bool()>& cancelled) { return LoadMesh(cancelled); };
  const absl::Status status = run->Run(load, queue_->options(), [&] { BecomeProvisional(run); });
  const double seconds = run->Report().progress.elapsed_seconds;
  if (status.ok()) {
    spdlog::info("build {} of mesh {} ended after {:.3f} s", run->number(), id(), seconds);
  } else if (absl::IsCancelled(status)) {
    spdlog::info("build {} of mesh {} was cancelled after {:.3f} s", run->number(), id(), seconds);
  } else {
    spdlog::error("build {} of mesh {} failed: {}", run->number(), id(), status.ToString());
  }
  End(run, status);
  if (queue_->on_build_end()) queue_->on_build_end()(run->Ended(id()));
}

absl::StatusOr<std::shared_ptr<const TriangleMesh>> MeshEntry::LoadMesh(const std::function<bool()>& cancelled) {
  {
    MutexLock lock(mutex_);
    if (uploaded_) mesh_ = uploaded_;
    if (std::shared_ptr<const TriangleMesh> mesh = mesh_.lock()) {
      uploaded_.reset();
      return mesh;
    }
  }
  absl::StatusOr<TriangleMesh> read = ReadMeshFile(path_, id(), cancelled);
  const auto mesh = read.ok() ? std::make_shared<const TriangleMesh>(*std::move(read)) : nullptr;

  MutexLock lock(mutex_);
  file_is_lost_ = absl::IsDataLoss(read.status()) || absl::IsNotFound(read.status());
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
    if (status.ok()) {
      old = std::exchange(finished_, run);
    } else if (finished_) {
      old = std::exchange(answering_, finished_);
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
  return absl::FailedPreconditionError(absl::StrCat("the build of mesh ", id(), " failed: ", status.message()));
}

}  // namespace deltaray
