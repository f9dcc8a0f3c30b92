#include "server/store/catalog.h"

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/store/mesh_name.h"
#include "spdlog/spdlog.h"

namespace deltaray {

absl::StatusOr<std::shared_ptr<MeshEntry>> Catalog::Find(absl::string_view mesh) const {
  MutexLock lock(mutex_);
  absl::string_view id = mesh;
  if (!IsMeshId(mesh)) {
    if (mesh.empty()) return absl::NotFoundError("mesh: is empty; it must be a mesh id or a name");
    // A name that may not be one is not repeated in the text.
    if (!ValidateMeshName(mesh).ok()) return absl::NotFoundError("no mesh: neither a mesh id nor a valid name");
    const auto name = names_.find(mesh);
    if (name == names_.end() || meshes_.count(name->second) == 0) {
      return absl::NotFoundError(absl::StrCat("no mesh is named ", mesh));
    }
    id = name->second;
  }
  const auto entry = meshes_.find(id);
  if (entry == meshes_.end()) return absl::NotFoundError(absl::StrCat("no mesh has the id ", id));
  return entry->second;
}

MeshInfo Catalog::Info(const MeshEntry& entry) const {
  MeshInfo info = entry.Info();
  const std::set<std::string> names = NamesOf(entry.id());
  info.names.assign(names.begin(), names.end());
  return info;
}

std::vector<std::shared_ptr<MeshEntry>> Catalog::List(absl::string_view after_id, size_t limit) const {
  std::vector<std::shared_ptr<MeshEntry>> page;
  MutexLock lock(mutex_);
  for (auto it = meshes_.upper_bound(after_id); it != meshes_.end() && page.size() < limit; ++it) {
    page.push_back(it->second);
  }
  return page;
}

std::set<std::string> Catalog::NamesOf(absl::string_view id) const {
  MutexLock lock(mutex_);
  const auto names = names_of_.find(id);
  return names == names_of_.end() ? std::set<std::string>() : names->second;
}

bool Catalog::HasName(absl::string_view name) const {
  MutexLock lock(mutex_);
  return names_.find(name) != names_.end();
}

Catalog::Totals Catalog::totals() const {
  MutexLock lock(mutex_);
  return {meshes_.size(), names_.size(), stored_bytes_};
}

void Catalog::Put(std::shared_ptr<MeshEntry> entry) {
  MutexLock lock(mutex_);
  if (!no_waiting_.ok()) entry->StopWaiting(no_waiting_);
  stored_bytes_ += entry->stored_bytes();
  meshes_[entry->id()].swap(entry);  // what was there is destroyed after the lock
  if (entry) stored_bytes_ -= entry->stored_bytes();
}

std::shared_ptr<MeshEntry> Catalog::Remove(absl::string_view id) {
  MutexLock lock(mutex_);
  const auto stored = meshes_.find(id);
  if (stored == meshes_.end()) return nullptr;
  std::shared_ptr<MeshEntry> entry = std::move(stored->second);
  meshes_.erase(stored);
  stored_bytes_ -= entry->stored_bytes();
  return entry;
}

std::string Catalog::MoveName(const std::string& name, const std::string& id) {
  std::string previous;
  MutexLock lock(mutex_);
  if (const auto it = names_.find(name); it != names_.end()) {
    previous = it->second;
    if (previous == id) return previous;
    const auto of = names_of_.find(previous);
    of->second.erase(name);
    if (of->second.empty()) names_of_.erase(of);
    names_.erase(it);
  }
  if (!id.empty()) {
    names_.emplace(name, id);
    names_of_[id].insert(name);
  }
  return previous;
}

void Catalog::StopWaiting(const absl::Status& status) {
  {
    MutexLock lock(mutex_);
    no_waiting_ = status;
  }
  for (const auto& entry : List("", SIZE_MAX)) entry->StopWaiting(status);
}

void Catalog::NoteWaitedFor(std::shared_ptr<MeshEntry> entry) {
  MutexLock lock(mutex_);
  waited_for_.insert(std::move(entry));
}

void Catalog::ForgetCancelled() {
  std::vector<std::shared_ptr<MeshEntry>> entries;
  {
    MutexLock lock(mutex_);
    entries.assign(waited_for_.begin(), waited_for_.end());
  }
  for (const std::shared_ptr<MeshEntry>& entry : entries) entry->ForgetCancelled();
  MutexLock lock(mutex_);
  std::erase_if(waited_for_, [](const std::shared_ptr<MeshEntry>& entry) { return !entry->IsWaitedFor(); });
}

bool Catalog::MakeRoom(uint64_t bytes) const {
  struct Droppable {
    std::chrono::steady_clock::time_point last_used;
    uint64_t bytes;
    std::shared_ptr<MeshEntry> entry;
  };
  std::vector<Droppable> all;
  uint64_t sum = 0;
  for (std::shared_ptr<MeshEntry>& entry : List("", SIZE_MAX)) {
    const uint64_t droppable = entry->DroppableBytes();
    if (droppable == 0) continue;
    sum += droppable;
    all.push_back({entry->last_used(), droppable, std::move(entry)});
  }
  if (sum < bytes) return false;
  std::sort(all.begin(), all.end(), [](const auto& a, const auto& b) { return a.last_used < b.last_used; });
  uint64_t dropped = 0;
  for (auto next = all.begin(); dropped < bytes; ++next) {
    if (const std::string what = next->entry->Drop(); !what.empty()) {
      spdlog::info("dropped the {} of mesh {} to make room", what, next->entry->id());
    }
    dropped += next->bytes;
  }
  return true;
}

}  // namespace deltaray
