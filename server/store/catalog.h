// The meshes and names that a server knows of.

#ifndef SERVER_STORE_CATALOG_H_
#define SERVER_STORE_CATALOG_H_

#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/build/mutex.h"
#include "server/store/mesh_entry.h"
#include "server/store/mesh_store.h"

namespace deltaray {

// In memory only: what happens on disk is brought here by who changes or reads it. A name may point at a mesh that is
// not known (yet): it then leads nowhere. Thread-safe; takes one short lock.
class Catalog {
 public:
  // The mesh of an id or a name. NOT_FOUND where there is none.
  absl::StatusOr<std::shared_ptr<MeshEntry>> Find(absl::string_view mesh) const;
  // With names, without groups.
  MeshInfo Info(const MeshEntry& entry) const;
  // At most `limit` meshes with id > after_id, in order of id.
  std::vector<std::shared_ptr<MeshEntry>> List(absl::string_view after_id, size_t limit) const;
  // Those that point at a mesh, which need not be known.
  std::set<std::string> NamesOf(absl::string_view id) const;

  // Whether a name points at a mesh, known or not.
  bool HasName(absl::string_view name) const;
  struct Totals {
    uint64_t meshes = 0, names = 0, stored_bytes = 0;
  };
  Totals totals() const;

  // Adds a mesh, or takes it in place of the one that had the id.
  void Put(std::shared_ptr<MeshEntry> entry);
  // Returns what was there; names stay. Null: nothing.
  std::shared_ptr<MeshEntry> Remove(absl::string_view id);
  // Points a name at a mesh; with an empty id takes it away. Returns the id that it pointed at before.
  std::string MoveName(const std::string& name, const std::string& id);

  // MeshEntry::StopWaiting, for all entries and those to come.
  void StopWaiting(const absl::Status& status);
  // Notes that somebody waits for the mesh's tree.
  void NoteWaitedFor(std::shared_ptr<MeshEntry> entry);
  // MeshEntry::ForgetCancelled, for all entries that somebody may wait for.
  void ForgetCancelled();
  // MeshEntry::Drop, for those that were not used for longest, as TreeBudget's make_room wants it.
  bool MakeRoom(uint64_t bytes) const;

 private:
  mutable Mutex mutex_;
  std::map<std::string, std::shared_ptr<MeshEntry>, std::less<>> meshes_ ABSL_GUARDED_BY(mutex_);
  std::map<std::string, std::string, std::less<>> names_ ABSL_GUARDED_BY(mutex_);               // to ids
  std::map<std::string, std::set<std::string>, std::less<>> names_of_ ABSL_GUARDED_BY(mutex_);  // by id; none is empty
  uint64_t stored_bytes_ ABSL_GUARDED_BY(mutex_) = 0;                                           // of all meshes
  absl::Status no_waiting_ ABSL_GUARDED_BY(mutex_);
  std::set<std::shared_ptr<MeshEntry>> waited_for_ ABSL_GUARDED_BY(mutex_);  // deleted ones too, until nobody waits
};

}  // namespace deltaray

#endif  // SERVER_STORE_CATALOG_H_
