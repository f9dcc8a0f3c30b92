// The C library's functions of these names are replaced in this program by those below, which make the same calls.

#include "tests/unit/store/watched_disk.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <system_error>
#include <utility>

#include "server/build/mutex.h"

namespace deltaray {
namespace {

struct Watch {
  Mutex mutex;
  bool on ABSL_GUARDED_BY(mutex) = false;
  std::function<int(const DiskCall&)> refuse ABSL_GUARDED_BY(mutex);
  std::vector<DiskCall> calls ABSL_GUARDED_BY(mutex);
};

Watch& TheWatch() {
  static Watch& watch = *new Watch;
  return watch;
}

int Watched(const std::function<DiskCall()>& describe, const std::function<long()>& make) {
  Watch& watch = TheWatch();
  // Held throughout, so that calls are noted in the order in which they were made.
  MutexLock lock(watch.mutex);
  if (!watch.on) return static_cast<int>(make());
  DiskCall call = describe();
  if (const int error = watch.refuse ? watch.refuse(call) : 0; error != 0) {
    errno = error;
    return -1;
  }
  const int result = static_cast<int>(make());
  if (result == 0) watch.calls.push_back(std::move(call));
  return result;
}

int64_t SizeOf(const std::string& path) {
  struct stat status;
  return stat(path.c_str(), &status) == 0 ? status.st_size : -1;
}

DiskCall SyncOf(int fd) {
  std::error_code error;
  const std::string path = std::filesystem::read_symlink("/proc/self/fd/" + std::to_string(fd), error).string();
  return {DiskCall::kSync, path, "", SizeOf(path)};
}

}  // namespace

WatchedDisk::WatchedDisk(std::function<int(const DiskCall&)> refuse) {
  MutexLock lock(TheWatch().mutex);
  TheWatch().on = true;
  TheWatch().refuse = std::move(refuse);
  TheWatch().calls.clear();
}

WatchedDisk::~WatchedDisk() {
  MutexLock lock(TheWatch().mutex);
  TheWatch().on = false;
}

std::vector<DiskCall> WatchedDisk::TakeCalls() {
  MutexLock lock(TheWatch().mutex);
  return std::exchange(TheWatch().calls, {});
}

std::function<int(const DiskCall&)> FailSyncsOf(const std::string& folder) {
  return [folder](const DiskCall& call) { return call.kind == DiskCall::kSync && call.path == folder ? EIO : 0; };
}

}  // namespace deltaray

extern "C" {

int fsync(int fd) {
  return deltaray::Watched([&] { return deltaray::SyncOf(fd); }, [&] { return syscall(SYS_fsync, fd); });
}

int fdatasync(int fd) {
  return deltaray::Watched([&] { return deltaray::SyncOf(fd); }, [&] { return syscall(SYS_fdatasync, fd); });
}

int rename(const char* from, const char* to) noexcept {
  using deltaray::DiskCall;
  return deltaray::Watched(
      [&] {
        return DiskCall{DiskCall::kRename, from, to, deltaray::SizeOf(from)};
      },
      [&] { return syscall(SYS_renameat, AT_FDCWD, from, AT_FDCWD, to); });
}

int unlink(const char* path) noexcept {
  using deltaray::DiskCall;
  return deltaray::Watched(
      [&] {
        return DiskCall{DiskCall::kUnlink, path, ""};
      },
      [&] { return syscall(SYS_unlinkat, AT_FDCWD, path, 0); });
}

int mkdir(const char* path, mode_t mode) noexcept {
  using deltaray::DiskCall;
  return deltaray::Watched(
      [&] {
        return DiskCall{DiskCall::kMakeFolder, path, ""};
      },
      [&] { return syscall(SYS_mkdirat, AT_FDCWD, path, mode); });
}

int faccessat(int folder, const char* path, int mode, int flags) noexcept {
  using deltaray::DiskCall;
  return deltaray::Watched(
      [&] {
        return DiskCall{DiskCall::kAccess, path, ""};
      },
      // For the user that the process acts as, as `flags` ask for.
      [&] { return syscall(SYS_faccessat2, folder, path, mode, flags); });
}

}  // extern "C"
