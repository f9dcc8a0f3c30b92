// Meshes on disk and in memory.

#ifndef SERVER_STORE_MESH_STORE_H_
#define SERVER_STORE_MESH_STORE_H_

#include <array>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/build/build.h"
#include "server/mesh/read_mesh.h"

namespace deltaray {

class FirstAnswer;

enum class MeshState : uint8_t { kStored, kBuilding, kProvisional, kReady, kFailed };

// What is known of a mesh without its geometry in memory.
struct MeshInfo {
  std::string id;
  std::vector<std::string> names;  // sorted
  uint64_t vertex_count = 0;
  uint64_t triangle_count = 0;
  uint64_t face_count = 0;
  Vec3d origin;
  MeshReport report;
  std::vector<std::string> groups;
  MeshState state = MeshState::kStored;
  Config config;
  std::chrono::system_clock::time_point created;
  uint64_t stored_bytes = 0;
  std::string failure;  // kFailed
};

// The progress of a mesh's build, and which build it is.
struct BuildReport {
  MeshState state = MeshState::kStored;
  // Counted from 1 over the builds of all meshes since the store was opened. 0: the mesh had none, or the build that it
  // is to have found no room in the queue yet.
  uint64_t build_number = 0;
  BuildProgress progress;
  std::string failure;
  bool answers = false;  // whether there is a tree to query now, of this build or of one before
};

// A build that has ended.
struct EndedBuild {
  std::string mesh_id;
  absl::Status status;  // CANCELLED where it was not wanted any more
  double seconds = 0;
  std::vector<PhaseTime> phases{};  // empty where it failed early
  uint64_t delta_leaves_built = 0;
};

// What all meshes take, and how far they are.
struct StoreUsage {
  std::array<uint64_t, 5> meshes{};  // by MeshState
  uint64_t disk_bytes = 0;
  bool directory_writable = true;  // as of a second ago or so; false where the disk has hung for 30 s
  uint64_t mesh_bytes = 0;         // geometry in memory
  uint64_t tree_bytes = 0;         // of trees whose build has ended
  // What counts towards Options::tree_bytes, builds and uploads included; and that limit.
  uint64_t budget_bytes = 0;
  uint64_t budget_limit = 0;
  uint64_t builds_waiting = 0;
  uint64_t builds_running = 0;
};

struct StoredStatistics {
  uint64_t build_number = 0;
  double first_answer_seconds = 0;  // 0: none yet
  BuildStatistics statistics;
  uint64_t mesh_bytes = 0;
};

// Whether `name` may be a mesh's name: 1 to 128 bytes of UTF-8 without control characters, not of the form of an id.
absl::Status ValidateMeshName(absl::string_view name);

// The bytes of an upload on their way to a mesh: a file in the data directory without a name, so that the kernel takes
// it away whatever happens to the server. Not thread-safe; must be gone before its store is.
class Upload {
 public:
  virtual ~Upload() = default;  // drops what was not committed

  // Appends bytes of the file. RESOURCE_EXHAUSTED over the limit on upload bytes or where the disk is full.
  virtual absl::Status Append(absl::string_view bytes) = 0;
  virtual uint64_t size() const = 0;

  struct CommitOptions {
    std::string name;              // empty: none
    std::optional<uint64_t> size;  // checked where set
    std::string sha256;            // 32 bytes; checked where not empty
    ReadMeshOptions read;          // but for its limits, which are the store's
    std::optional<Config> config;  // unset: keep the mesh's, or the default
  };
  struct Committed {
    MeshInfo info;
    bool created = false;
  };
  // Reads the file as a mesh, stores it durably, gives it its name and starts its build. REQUIRES: called once.
  virtual absl::StatusOr<Committed> Commit(CommitOptions options) = 0;
};

// The meshes of a data directory, which any number of stores may share, in one process or on many machines. All methods
// are thread-safe; those that touch the disk block, none waits for a build.
//
// `mesh` is an id or a name; NOT_FOUND where there is no such mesh, DATA_LOSS or FAILED_PRECONDITION where its file is
// damaged or cannot be read. A mesh or name that is not known is looked for on disk at once, but by methods that say
// that they do not; that a known one was moved or deleted by another server is noticed within a few
// Options::follow_interval. Changes are UNAVAILABLE where another server holds up all changes for
// Options::change_timeout, or has done so just before.
class MeshStore {
 public:
  struct Options {
    std::string data_directory;  // made where missing
    uint64_t max_upload_bytes = uint64_t{4} << 30;
    MeshLimits mesh_limits;
    // Of the whole directory, as far as this store has noticed what others have stored. What is over one of them gives
    // RESOURCE_EXHAUSTED and a text with the limit's name and value.
    uint64_t max_meshes = 100'000;
    uint64_t max_names = 100'000;
    uint64_t max_names_per_mesh = 1'000;
    uint64_t max_stored_bytes = uint64_t{1} << 40;  // mesh files, and uploads on their way
    // Memory of meshes and trees; builds and uploads that are being read included. Trees that were not used for longest
    // make room for others, and are built again when they are asked for.
    uint64_t tree_bytes = uint64_t{8} << 30;
    uint32_t concurrent_builds = 1;
    uint32_t max_queued_builds = 1'024;  // that wait for their turn
    uint32_t build_threads = 0;          // 0: all cores
    // How long it takes to notice what other servers change in the directory.
    std::chrono::milliseconds follow_interval{250};
    // How long a change waits for those of others before it is UNAVAILABLE. A change takes milliseconds: a server that
    // holds the directory's lock for this long has been stopped, or has lost the disk. Those that come after that,
    // until one gets the lock but not for longer than this again, wait for a hundredth of it.
    std::chrono::milliseconds change_timeout{10'000};
    std::function<void()> on_delta_leaf;  // see Build::Options; for tests that need a slow build
    // Called at the end of every build, from its thread. Must not call the store.
    std::function<void(const EndedBuild&)> on_build_end;
  };

  // Opens the directory and reads what is there. A file that is not whole is reported in the log, and left out.
  static absl::StatusOr<std::unique_ptr<MeshStore>> Open(Options options);

  // Cancels all builds and waits for their end.
  virtual ~MeshStore() = default;

  virtual absl::StatusOr<std::unique_ptr<Upload>> StartUpload() = 0;

  // Reads the groups from the mesh's file.
  virtual absl::StatusOr<MeshInfo> Get(absl::string_view mesh) const = 0;
  // The id of a mesh, where there is such a mesh. Cheap where it is known.
  virtual absl::StatusOr<std::string> Resolve(absl::string_view mesh) const = 0;
  // The same, but NOT_FOUND where it is not known. Cheap, and never blocks.
  virtual absl::StatusOr<std::string> ResolveKnown(absl::string_view mesh) const = 0;
  bool IsKnown(absl::string_view mesh) const { return ResolveKnown(mesh).ok(); }
  // At most `limit` meshes with id > after_id, in order of id, without groups.
  virtual std::vector<MeshInfo> List(absl::string_view after_id, size_t limit) const = 0;

  // Points `name` at `mesh`, durably; with empty `mesh` takes the name away. Returns the id it pointed at before.
  virtual absl::StatusOr<std::string> Name(absl::string_view name, absl::string_view mesh) = 0;
  // Returns the id. Snapshots that were handed out stay valid.
  virtual absl::StatusOr<std::string> Delete(absl::string_view mesh) = 0;

  // Starts a build with this config, which is kept for later builds too; cancels the one under way. The old tree
  // answers until the new one can, unless it has to make room for it.
  virtual absl::StatusOr<MeshInfo> Rebuild(absl::string_view mesh, const Config& config) = 0;

  struct Answer {
    std::string id;
    std::shared_ptr<const TreeSnapshot> snapshot;
    std::shared_ptr<FirstAnswer> first_answer;  // for NoteAnswer
  };
  // Of a mesh that is known, or else NOT_FOUND: calls `callback` once with a tree to query: with `final`, the final one
  // as soon as it stands, else the best there is as soon as there is one. Starts the build where there is none. The
  // callback may come at once, on the calling thread, or later, on another; it must neither block nor throw. Where the
  // build failed: DATA_LOSS for a damaged file, RESOURCE_EXHAUSTED where there is no room for the tree, else
  // FAILED_PRECONDITION. `cancelled` tells, on any thread, that nobody wants the tree any more: ForgetCancelled then
  // lets go of the callback, which is not called.
  virtual void WithTree(absl::string_view mesh, bool final, std::function<void(absl::StatusOr<Answer>)> callback,
                        std::function<bool()> cancelled = nullptr) = 0;

  // Lets go of the callbacks whose tree nobody wants any more. To be called several times a second.
  virtual void ForgetCancelled() = 0;

  // From now on nobody waits for a tree: the callbacks that do, and later ones for which there is no tree, get
  // `status`. Builds go on.
  virtual void StopWaiting(const absl::Status& status) = 0;

  // Notes that a ray was answered from the mesh's current build, for BuildStats.first_answer_seconds. Cheap.
  virtual void NoteAnswer(const Answer& answer) = 0;

  // How far the build of a mesh is that is known, or else NOT_FOUND; with `start`, of a mesh that is only stored the
  // build is started. Never blocks.
  virtual absl::StatusOr<BuildReport> Watch(absl::string_view mesh, bool start = true) = 0;
  virtual absl::StatusOr<StoredStatistics> Statistics(absl::string_view mesh) const = 0;
  // Looks at every mesh, but at no tree.
  virtual StoreUsage Usage() const = 0;
};

}  // namespace deltaray

#endif  // SERVER_STORE_MESH_STORE_H_
