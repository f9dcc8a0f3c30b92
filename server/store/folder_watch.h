// Notices what changes in a folder, whoever changes it, on any machine.

#ifndef SERVER_STORE_FOLDER_WATCH_H_
#define SERVER_STORE_FOLDER_WATCH_H_

#include <sys/stat.h>

#include <chrono>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace deltaray {

// The files of a folder that are named after a digest: 64 hexadecimal digits and an ending. Network file systems tell
// nobody of changes, so that the folder is looked at again and again: as long as its own time of change stays the same
// that is one system call, else the folder is listed.
//
// Times of change are coarse (a tick of the kernel, a second on some file systems), so that something may happen to a
// folder or a file right after a look and leave its time as it was. So what was seen to change counts as changed for
// kSettle more. Only times of the folder and its files are compared with each other, never with a clock of this
// machine, which may go wrong.
//
// Not thread-safe.
class FolderWatch {
 public:
  using Clock = std::chrono::steady_clock;
  static constexpr std::chrono::seconds kSettle{2};

  FolderWatch(std::string path, std::string ending) : path_(std::move(path)), ending_(std::move(ending)) {}

  // Digests of files, in order.
  struct Changes {
    std::vector<std::string> present;  // new, replaced, or so young that they may have been
    std::vector<std::string> gone;
  };
  // What has changed since the last call; all files at the first one. After an error nothing has changed, and the next
  // call tells what has. Files of other names are logged once.
  absl::StatusOr<Changes> Look(Clock::time_point now = Clock::now());

  // Tells at the next look whether a file is there or gone: one that could not be read, or is known from elsewhere.
  void TellOf(const std::string& digest);

 private:
  // What tells a file, or a folder, from what was there before.
  struct Stamp {
    uint64_t inode = 0;
    int64_t size = 0, modified = 0, changed = 0;  // bytes; nanoseconds
    bool operator==(const Stamp&) const = default;
  };
  struct Known {
    Stamp stamp;
    Clock::time_point since;  // when it was first seen so
    bool untold = false;      // whether it has changed since it was told of
    uint64_t listing = 0;     // the last one that it was in
  };
  static Stamp StampOf(const struct stat& status);

  const std::string path_;
  const std::string ending_;
  Stamp folder_;
  Clock::time_point folder_since_;
  bool settled_ = false;  // whether nothing can have happened to the folder that its stamp does not tell
  bool reported_foreign_ = false;
  uint64_t listings_ = 0;
  std::map<std::string, Known> files_;  // by digest
};

}  // namespace deltaray

#endif  // SERVER_STORE_FOLDER_WATCH_H_
