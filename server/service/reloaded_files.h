// Files of the operator that are read again when they change, while the server runs.

#ifndef SERVER_SERVICE_RELOADED_FILES_H_
#define SERVER_SERVICE_RELOADED_FILES_H_

#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/build/mutex.h"

namespace deltaray {

struct ReloadedFile {
  std::string flag;  // that named it
  std::string path;
  std::string bytes;

  // INVALID_ARGUMENT that names the flag and the file.
  absl::Status Error(absl::string_view what) const;
};

// Looks at the bytes of some files, which belong together, every half second, and hands them on once they have changed
// and were the same twice: a file that is being written is not read half. Whatever way of replacing files is used
// shows, links to other directories too.
class ReloadedFiles {
 public:
  // Takes what the files hold. Not OK: it is no good, and what was taken before stays in use. Must not throw.
  using Load = std::function<absl::Status(const std::vector<ReloadedFile>& files)>;

  // Loads the files, which have no bytes yet; fails where one cannot be read, or `load` does not take them. `load` is
  // called on this thread, and until the end of this on another one; what it says then is logged.
  static absl::StatusOr<std::unique_ptr<ReloadedFiles>> Start(std::vector<ReloadedFile> files, Load load);
  ~ReloadedFiles();

 private:
  ReloadedFiles(std::vector<ReloadedFile> files, Load load) : files_(std::move(files)), load_(std::move(load)) {}

  void Watch();

  std::vector<ReloadedFile> files_;  // as they were last given to load_; once it runs, the thread's
  const Load load_;
  Mutex mutex_;
  Condition ending_changed_;
  bool ending_ ABSL_GUARDED_BY(mutex_) = false;
  std::thread thread_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_RELOADED_FILES_H_
