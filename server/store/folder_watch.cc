#include "server/store/folder_watch.h"

#include <dirent.h>
#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <memory>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "server/store/durable_file.h"
#include "server/store/mesh_name.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

int64_t Nanoseconds(const timespec& time) { return int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec; }

}  // namespace

FolderWatch::Stamp FolderWatch::StampOf(const struct stat& status) {
  return {status.st_ino, status.st_size, Nanoseconds(status.st_mtim), Nanoseconds(status.st_ctim)};
}

absl::StatusOr<FolderWatch::Changes> FolderWatch::Look(Clock::time_point now) {
  // The time of change is read before the list, so that what comes after is noticed at the next look.
  struct stat status;
  if (stat(path_.c_str(), &status) != 0) return FolderError(errno, "examine", path_);
  if (const Stamp stamp = StampOf(status); stamp != folder_ || listings_ == 0) {
    folder_ = stamp;
    folder_since_ = now;
    settled_ = false;
  }
  Changes changes;
  if (settled_) return changes;

  const std::unique_ptr<DIR, int (*)(DIR*)> folder(opendir(path_.c_str()), closedir);
  if (!folder) return FolderError(errno, "list", path_);
  ++listings_;
  for (;;) {
    errno = 0;
    const dirent* const entry = readdir(folder.get());
    if (entry == nullptr) break;
    absl::string_view digest = entry->d_name;
    if (digest == "." || digest == "..") continue;
    if (!absl::ConsumeSuffix(&digest, ending_) || !IsMeshId(digest)) {
      if (!reported_foreign_)
        spdlog::warn("left out: {}/{} is no file of deltaray's", path_, absl::CHexEscape(entry->d_name));
      continue;
    }
    if (fstatat(dirfd(folder.get()), entry->d_name, &status, AT_SYMLINK_NOFOLLOW) != 0) {
      if (errno == ENOENT) continue;
      return FileError(errno, "examine", absl::StrCat(path_, "/", entry->d_name));
    }
    Known& file = files_[std::string(digest)];
    if (const Stamp stamp = StampOf(status); stamp != file.stamp) file = {stamp, now, /*untold=*/true};
    file.listing = listings_;
  }
  if (errno != 0) return FileError(errno, "list", path_);
  reported_foreign_ = true;

  for (auto it = files_.begin(); it != files_.end();) {
    Known& file = it->second;
    if (file.listing != listings_) {
      // A file that takes another's place while the folder is listed may be missing in the list.
      const std::string path = absl::StrCat(path_, "/", it->first, ending_);
      if (lstat(path.c_str(), &status) == 0) {
        file = {StampOf(status), now, /*untold=*/true};
      } else if (errno == ENOENT) {
        changes.gone.push_back(it->first);
        it = files_.erase(it);
        continue;
      }
    }
    if (std::exchange(file.untold, false) || now - file.since < kSettle) changes.present.push_back(it->first);
    ++it;
  }
  settled_ = now - folder_since_ >= kSettle;
  return changes;
}

void FolderWatch::TellOf(const std::string& digest) {
  settled_ = false;
  files_[digest].untold = true;
}

}  // namespace deltaray
