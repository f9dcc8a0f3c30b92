#include "server/store/mesh_store.h"

#include <atomic>
#include <memory>
#include <string>
#include <utility>

#include "server/store/store.h"

namespace deltaray {
namespace {

// How often a mesh is asked for again that was deleted and is there again.
constexpr int kTriesOfDeletedMesh = 3;

absl::StatusOr<std::string> IdOf(const absl::StatusOr<EntryPointer>& entry) {
  if (!entry.ok()) return entry.status();
  return (*entry)->id();
}

}  // namespace

Store::Store(Options options, DataDirectory directory, DataDirectory::Changes contents)
    : options_(std::move(options)),
      queue_(options_.concurrent_builds, options_.max_queued_builds,
             {.config = {}, .threads = options_.build_threads, .on_delta_leaf = options_.on_delta_leaf},
             options_.on_build_end),
      tree_budget_(std::make_shared<TreeBudget>(
          options_.tree_bytes, [this](uint64_t bytes) { return directory_.catalog().MakeRoom(bytes); })),
      disk_budget_(options_.max_stored_bytes, [this] { return directory_.catalog().totals().stored_bytes; }),
      directory_(std::move(directory), std::move(contents), options_.follow_interval,
                 [this](MeshInfo info) { return MakeEntry(std::move(info)); }),
      change_lock_(&directory_.files(), options_.change_timeout) {}

Store::~Store() {
  for (const EntryPointer& entry : directory_.catalog().List("", SIZE_MAX)) {
    entry->Close(absl::UnavailableError("the server is shutting down"));
  }
  queue_.Stop();
}

EntryPointer Store::MakeEntry(MeshInfo info) const {
  std::string path = directory_.files().MeshPath(info.id);
  return std::make_shared<MeshEntry>(std::move(info), std::move(path), &queue_, tree_budget_.get());
}

absl::StatusOr<MeshInfo> Store::Get(absl::string_view mesh) const {
  for (int tries = kTriesOfDeletedMesh;; --tries) {
    const absl::StatusOr<EntryPointer> entry = directory_.Find(mesh);
    if (!entry.ok()) return entry.status();
    absl::StatusOr<std::vector<std::string>> groups = directory_.files().ReadGroups((*entry)->id());
    if (groups.ok()) {
      MeshInfo info = directory_.catalog().Info(**entry);
      info.groups = *std::move(groups);
      return info;
    }
    if (!absl::IsNotFound(groups.status()) || tries == 0) return groups.status();
    // Another server has deleted it; it may be there again.
    directory_.IsThere((*entry)->id());
  }
}

absl::StatusOr<std::string> Store::Resolve(absl::string_view mesh) const { return IdOf(directory_.Find(mesh)); }

absl::StatusOr<std::string> Store::ResolveKnown(absl::string_view mesh) const {
  return IdOf(directory_.catalog().Find(mesh));
}

std::vector<MeshInfo> Store::List(absl::string_view after_id, size_t limit) const {
  std::vector<MeshInfo> infos;
  for (const EntryPointer& entry : directory_.catalog().List(after_id, limit))
    infos.push_back(directory_.catalog().Info(*entry));
  return infos;
}

void Store::WithTree(absl::string_view mesh, bool final, std::function<void(absl::StatusOr<Answer>)> callback,
                     std::function<bool()> cancelled) {
  WithTree(directory_.catalog().Find(mesh), std::string(mesh), final, kTriesOfDeletedMesh, std::move(callback),
           std::move(cancelled));
}

void Store::WithTree(const absl::StatusOr<EntryPointer>& entry, const std::string& mesh, bool final, int tries,
                     std::function<void(absl::StatusOr<Answer>)> callback, std::function<bool()> cancelled) {
  if (!entry.ok()) return callback(entry.status());
  // The caller must not wait for the disk; a thread of a build, which calls back later, may.
  const auto returned = std::make_shared<std::atomic<bool>>(tries < kTriesOfDeletedMesh);
  auto on_tree = [this, mesh, id = (*entry)->id(), final, tries, callback = std::move(callback), cancelled,
                  returned](absl::StatusOr<Answer> answer) {
    // Another server had deleted the mesh, and it may have been uploaded again before it was asked for.
    if (!absl::IsNotFound(answer.status()) || tries == 0 || !*returned || !directory_.IsThere(id)) {
      return callback(std::move(answer));
    }
    WithTree(directory_.Find(mesh), mesh, final, tries - 1, callback, cancelled);
  };
  if ((*entry)->WithTree(final, std::move(on_tree), std::move(cancelled))) directory_.catalog().NoteWaitedFor(*entry);
  *returned = true;
}

void Store::NoteAnswer(const Answer& answer) {
  if (answer.first_answer) answer.first_answer->Note();
}

absl::StatusOr<BuildReport> Store::Watch(absl::string_view mesh, bool start) {
  const absl::StatusOr<EntryPointer> entry = directory_.catalog().Find(mesh);
  if (!entry.ok()) return entry.status();
  return (*entry)->Watch(start);
}

absl::StatusOr<StoredStatistics> Store::Statistics(absl::string_view mesh) const {
  const absl::StatusOr<EntryPointer> entry = directory_.Find(mesh);
  if (!entry.ok()) return entry.status();
  return (*entry)->Statistics();
}

StoreUsage Store::Usage() const {
  StoreUsage usage;
  for (const EntryPointer& entry : directory_.catalog().List("", SIZE_MAX)) entry->AddUsage(&usage);
  usage.disk_bytes = directory_.catalog().totals().stored_bytes;
  usage.directory_writable = directory_.is_writable();
  usage.budget_bytes = tree_budget_->used();
  usage.budget_limit = tree_budget_->limit();
  usage.builds_waiting = queue_.waiting();
  usage.builds_running = queue_.running();
  return usage;
}

absl::StatusOr<std::unique_ptr<MeshStore>> MeshStore::Open(Options options) {
  DataDirectory::Changes contents;
  absl::StatusOr<DataDirectory> directory =
      DataDirectory::Open(options.data_directory, options.change_timeout, &contents);
  if (!directory.ok()) return directory.status();
  return std::make_unique<Store>(std::move(options), *std::move(directory), std::move(contents));
}

}  // namespace deltaray
