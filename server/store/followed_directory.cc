#include "server/store/followed_directory.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/store/durable_file.h"
#include "server/store/mesh_name.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

// How often it is looked whether the directory can be written to.
constexpr std::chrono::seconds kWritableInterval{1};
constexpr std::chrono::seconds kLongestPause{5};
// How often temporaries of servers that died are looked for.
constexpr std::chrono::minutes kSweepInterval{1};

}  // namespace

DroppedEntries::~DroppedEntries() {
  for (const EntryPointer& entry : entries_) {
    entry->Close(absl::NotFoundError(absl::StrCat("mesh ", entry->id(), " was deleted")));
  }
}

FollowedDirectory::FollowedDirectory(DataDirectory directory, DataDirectory::Changes contents,
                                     std::chrono::milliseconds interval,
                                     std::function<EntryPointer(MeshInfo)> make_entry, std::chrono::milliseconds hang)
    : interval_(interval),
      hang_(hang),
      make_entry_(std::move(make_entry)),
      hangs_from_((std::chrono::steady_clock::now() + hang).time_since_epoch()),
      directory_(std::move(directory)) {
  {
    DroppedEntries none;
    MutexLock lock(mutex_);
    Take(std::move(contents), &none);
  }
  LookWhetherWritable();
  follower_ = std::thread([this] { Follow(); });
}

FollowedDirectory::~FollowedDirectory() {
  {
    MutexLock lock(stop_mutex_);
    stopped_ = true;
    stop_changed_.notify_all();
  }
  follower_.join();
}

void FollowedDirectory::NotePut(EntryPointer entry) {
  directory_.TellOfMesh(entry->id());
  catalog_.Put(std::move(entry));
}

absl::StatusOr<EntryPointer> FollowedDirectory::Find(absl::string_view mesh) {
  absl::StatusOr<EntryPointer> known = catalog_.Find(mesh);
  if (known.ok() || (!IsMeshId(mesh) && !ValidateMeshName(mesh).ok())) return known;
  DroppedEntries dropped;
  MutexLock lock(mutex_);
  return ReadTarget(mesh, &dropped);
}

absl::StatusOr<EntryPointer> FollowedDirectory::ReadTarget(absl::string_view mesh, DroppedEntries* dropped) {
  std::string id(mesh);
  if (!IsMeshId(mesh)) {
    absl::StatusOr<std::string> pointed = ValidateMeshName(mesh).ok() ? ReadName(id) : absl::NotFoundError("");
    if (absl::IsNotFound(pointed.status())) return catalog_.Find(mesh).status();
    if (!pointed.ok()) return pointed.status();
    id = *std::move(pointed);
  }
  absl::StatusOr<EntryPointer> entry = ReadMesh(id, dropped);
  return absl::IsNotFound(entry.status()) ? catalog_.Find(mesh) : entry;
}

absl::StatusOr<EntryPointer> FollowedDirectory::ReadMesh(const std::string& id, DroppedEntries* dropped) {
  absl::StatusOr<MeshInfo> info = directory_.ReadMesh(id);
  if (info.ok()) {
    directory_.TellOfMesh(id);
    return TakeMesh(*std::move(info));
  }
  if (absl::IsNotFound(info.status())) {
    dropped->Add(catalog_.Remove(id));
  } else if (absl::StatusOr<EntryPointer> known = catalog_.Find(id); known.ok()) {
    return known;  // what was read of it before is right
  }
  return info.status();
}

absl::StatusOr<std::string> FollowedDirectory::ReadName(const std::string& name) {
  absl::StatusOr<std::string> id = directory_.ReadName(name);
  if (id.ok() || absl::IsNotFound(id.status())) NoteName(name, id.ok() ? *id : "");
  return id;
}

EntryPointer FollowedDirectory::TakeMesh(MeshInfo info) {
  if (const absl::StatusOr<EntryPointer> known = catalog_.Find(info.id); known.ok()) {
    (*known)->SetConfig(info.config);
    return *known;
  }
  EntryPointer entry = make_entry_(std::move(info));
  catalog_.Put(entry);
  return entry;
}

absl::Status FollowedDirectory::ReadAll(DroppedEntries* dropped) {
  DataDirectory::Changes changes;
  const absl::Status status = directory_.Look(&changes);
  Take(std::move(changes), dropped);
  return status;
}

std::string FollowedDirectory::NoteName(const std::string& name, const std::string& id) {
  if (!id.empty()) directory_.TellOfName(name);
  return catalog_.MoveName(name, id);
}

void FollowedDirectory::Take(DataDirectory::Changes changes, DroppedEntries* dropped) {
  for (MeshInfo& info : changes.meshes) TakeMesh(std::move(info));
  for (const std::string& id : changes.gone_meshes) dropped->Add(catalog_.Remove(id));
  for (const auto& [id, config] : changes.configs) {
    if (const absl::StatusOr<EntryPointer> entry = catalog_.Find(id); entry.ok()) (*entry)->SetConfig(config);
  }
  for (const NameRecord& record : changes.names) {
    catalog_.MoveName(record.name, record.id);
    // The mesh may have come after meshes were looked at.
    if (!catalog_.Find(record.id).ok()) ReadMesh(record.id, dropped).IgnoreError();
  }
  for (const std::string& name : changes.gone_names) catalog_.MoveName(name, "");
}

EntryPointer FollowedDirectory::ReadWhole(const std::string& id, DroppedEntries* dropped) {
  const absl::StatusOr<EntryPointer> entry = ReadMesh(id, dropped);
  return entry.ok() && directory_.HasMesh(id) && !(*entry)->file_is_lost() ? *entry : nullptr;
}

bool FollowedDirectory::IsThere(const std::string& id) {
  DroppedEntries dropped;
  MutexLock lock(mutex_);
  return ReadMesh(id, &dropped).ok();
}

EntryPointer FollowedDirectory::FindWhole(const std::string& id) {
  DroppedEntries dropped;
  MutexLock lock(mutex_);
  return ReadWhole(id, &dropped);
}

void FollowedDirectory::LookWhetherWritable() {
  const absl::Status status = directory_.CheckWritable();
  if (is_writable_.exchange(status.ok()) == status.ok()) return;
  if (status.ok()) {
    spdlog::info("the data directory can be written to again");
  } else {
    spdlog::warn("the data directory cannot be written to, uploads and other changes will fail: {}", status.ToString());
  }
}

void FollowedDirectory::Follow() {
  using Clock = std::chrono::steady_clock;
  absl::Status last;
  Clock::time_point swept = Clock::now(), looked = swept;
  for (;;) {
    const Clock::time_point begin = Clock::now();
    absl::Status status;
    {
      DroppedEntries dropped;
      MutexLock lock(mutex_);
      status = ReadAll(&dropped);
    }
    if (status.code() != last.code()) {
      if (status.ok()) {
        spdlog::info("changes of other servers can be seen again");
      } else {
        spdlog::error("changes of other servers cannot be seen: {}", status.ToString());
      }
    }
    last = status;
    if (begin - looked >= kWritableInterval) {
      looked = begin;
      LookWhetherWritable();
    }
    if (begin - swept >= kSweepInterval) {
      swept = begin;
      RemoveAbandonedFiles(directory_.TemporariesPath());
    }
    // Where there is much to look at, a tenth of the time at most; where the disk did not answer for long, soon again.
    const Clock::duration took = Clock::now() - begin;
    const Clock::time_point next =
        Clock::now() + std::clamp<Clock::duration>(9 * took, interval_, interval_ + kLongestPause);
    hangs_from_ = (next + hang_).time_since_epoch();
    MutexLock lock(stop_mutex_);
    while (!stopped_ && Clock::now() < next) stop_changed_.wait_until(stop_mutex_, next);
    if (stopped_) return;
  }
}

}  // namespace deltaray
