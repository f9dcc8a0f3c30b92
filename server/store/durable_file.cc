#include "server/store/durable_file.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <ctime>
#include <filesystem>
#include <random>
#include <system_error>
#include <thread>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

constexpr mode_t kFileMode = 0640;
constexpr mode_t kFolderMode = 0750;
// Where locks tell nothing, a temporary this old has no writer any more.
constexpr time_t kAbandonedSeconds = 24 * 3600;
// How often a lock that somebody else has is tried.
constexpr std::chrono::milliseconds kLockInterval{1};

// Repeats a system call that a signal interrupted.
template <typename Call>
auto Retry(Call call) {
  decltype(call()) result;
  do {
    result = call();
  } while (result == -1 && errno == EINTR);
  return result;
}

std::string RandomFileName() {
  std::random_device random;
  return absl::StrFormat("%08x%08x%08x%08x", random(), random(), random(), random());
}

std::string FolderOf(const std::string& path) {
  const std::string folder = std::filesystem::path(path).parent_path().string();
  return folder.empty() ? "." : folder;
}

absl::Status IsGone(const std::string& folder) {
  return absl::FailedPreconditionError(absl::StrCat("data directory is gone: no ", folder));
}

// Of a file that was to be made, so that it is its folder that is not there.
absl::Status CreationError(int error, absl::string_view action, const std::string& path) {
  return error == ENOENT ? IsGone(FolderOf(path)) : FileError(error, action, path);
}

// Whether the process may do this to the file or folder; otherwise errno tells why not.
bool IsPermitted(const std::string& path, int mode) {
  if (faccessat(AT_FDCWD, path.c_str(), mode, AT_EACCESS) == 0) return true;
  // So do sandboxes answer that are older than faccessat2. access() asks for the real user, which servers are started
  // as.
  return (errno == EPERM || errno == ENOSYS) && access(path.c_str(), mode) == 0;
}

// Whether the writer of an open temporary is gone, as far as can be told.
bool IsAbandoned(int fd) {
  if (Retry([&] { return flock(fd, LOCK_EX | LOCK_NB); }) == 0) return true;
  if (errno == EWOULDBLOCK) return false;
  struct stat status;
  return fstat(fd, &status) == 0 && status.st_mtime < std::time(nullptr) - kAbandonedSeconds;
}

}  // namespace

FileDescriptor& FileDescriptor::operator=(FileDescriptor&& other) noexcept {
  if (fd_ >= 0) close(fd_);
  fd_ = other.Release();
  return *this;
}

FileDescriptor::~FileDescriptor() {
  if (fd_ >= 0) close(fd_);
}

absl::Status FileError(int error, absl::string_view action, absl::string_view path) {
  const std::string text = absl::StrCat("cannot ", action, " ", path, ": ", std::generic_category().message(error));
  switch (error) {
    case ENOSPC:
    case EDQUOT:
      return absl::ResourceExhaustedError(absl::StrCat("disk full: ", text));
    case EFBIG:
      return absl::ResourceExhaustedError(absl::StrCat("file size limit met: ", text));
    case EMFILE:
    case ENFILE:
    case ENOMEM:
      return absl::ResourceExhaustedError(text);
    case EROFS:
    case EACCES:
    case EPERM:
      return absl::FailedPreconditionError(absl::StrCat("data directory is not writable or readable: ", text));
    case ENOENT: {
      const std::string folder = FolderOf(std::string(path));
      std::error_code none;
      return std::filesystem::exists(folder, none) || none ? absl::NotFoundError(text) : IsGone(folder);
    }
    default:
      return absl::InternalError(text);
  }
}

absl::Status FolderError(int error, absl::string_view action, const std::string& path) {
  return error == ENOENT ? IsGone(path) : FileError(error, action, path);
}

absl::StatusOr<FileDescriptor> OpenToRead(const std::string& path) {
  // Without O_NONBLOCK a FIFO that somebody put there would block the server.
  FileDescriptor file(Retry([&] { return open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK); }));
  if (!file.IsOpen()) return FileError(errno, "open", path);
  struct stat status;
  if (fstat(file.get(), &status) != 0) return FileError(errno, "examine", path);
  if (!S_ISREG(status.st_mode)) return absl::DataLossError(absl::StrCat(path, " is not a regular file"));
  return file;
}

absl::StatusOr<uint64_t> FileSize(const FileDescriptor& file, const std::string& path) {
  struct stat status;
  if (fstat(file.get(), &status) != 0) return FileError(errno, "examine", path);
  return static_cast<uint64_t>(status.st_size);
}

absl::Status ReadAt(const FileDescriptor& file, uint64_t offset, std::span<char> bytes, const std::string& path) {
  while (!bytes.empty()) {
    const ssize_t count =
        Retry([&] { return pread(file.get(), bytes.data(), bytes.size(), static_cast<off_t>(offset)); });
    if (count < 0) return FileError(errno, "read", path);
    if (count == 0) return absl::DataLossError(absl::StrCat(path, " is truncated at byte ", offset));
    offset += static_cast<uint64_t>(count);
    bytes = bytes.subspan(static_cast<size_t>(count));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::string> ReadSmallFile(const std::string& path, uint64_t limit) {
  absl::StatusOr<FileDescriptor> file = OpenToRead(path);
  if (!file.ok()) return file.status();
  const absl::StatusOr<uint64_t> size = FileSize(*file, path);
  if (!size.ok()) return size.status();
  if (*size > limit) return absl::DataLossError(absl::StrCat(path, " has ", *size, " bytes; at most ", limit));
  std::string content(*size, '\0');
  if (absl::Status status = ReadAt(*file, 0, content, path); !status.ok()) return status;
  return content;
}

absl::Status WriteAll(const FileDescriptor& file, absl::string_view bytes, const std::string& path) {
  while (!bytes.empty()) {
    const ssize_t count = Retry([&] { return write(file.get(), bytes.data(), bytes.size()); });
    if (count < 0) return FileError(errno, "write", path);
    bytes.remove_prefix(static_cast<size_t>(count));
  }
  return absl::OkStatus();
}

absl::Status MakeFolder(const std::string& path) {
  std::error_code error;
  if (std::filesystem::is_directory(path, error)) return absl::OkStatus();
  const std::string above = FolderOf(path);
  if (absl::Status status = MakeFolder(above); !status.ok()) return status;
  // Another server may make it at the same time.
  if (mkdir(path.c_str(), kFolderMode) != 0 && errno != EEXIST) return FileError(errno, "make folder", path);
  if (!std::filesystem::is_directory(path, error)) return FileError(ENOTDIR, "make folder", path);
  return SyncFolder(above);
}

absl::Status SyncFolder(const std::string& path) {
  const FileDescriptor folder(Retry([&] { return open(path.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC); }));
  if (!folder.IsOpen()) return FolderError(errno, "open", path);
  // Some network file systems cannot sync a folder, and keep its entries safe without.
  if (Retry([&] { return fsync(folder.get()); }) != 0 && errno != EINVAL) return FileError(errno, "sync", path);
  return absl::OkStatus();
}

absl::Status SyncFolderOf(const std::string& path) { return SyncFolder(FolderOf(path)); }

absl::Status RemoveFile(const std::string& path) { return RemoveFiles(FolderOf(path), {&path, 1}); }

absl::Status RemoveFiles(const std::string& folder, std::span<const std::string> paths) {
  for (const std::string& path : paths) {
    if (unlink(path.c_str()) != 0 && errno != ENOENT) return FileError(errno, "remove", path);
  }
  return SyncFolder(folder);
}

absl::Status CheckWritable(const std::string& path) {
  if (IsPermitted(path, W_OK | X_OK)) return absl::OkStatus();
  return FolderError(errno, "write to", path);
}

absl::Status CheckLockable(const std::string& path) {
  if (IsPermitted(path, R_OK | W_OK)) return absl::OkStatus();
  return errno == ENOENT ? CheckWritable(FolderOf(path)) : FileError(errno, "write to", path);
}

absl::StatusOr<FileDescriptor> LockFile(const std::string& path, std::chrono::milliseconds timeout) {
  FileDescriptor file(Retry([&] { return open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, kFileMode); }));
  if (!file.IsOpen()) return CreationError(errno, "open", path);
  const auto deadline = std::chrono::steady_clock::now() + timeout;
  while (Retry([&] { return flock(file.get(), LOCK_EX | LOCK_NB); }) != 0 && errno == EWOULDBLOCK) {
    if (std::chrono::steady_clock::now() >= deadline) {
      return absl::UnavailableError(absl::StrCat("another process, a server or a back-up, holds the lock ", path));
    }
    std::this_thread::sleep_for(kLockInterval);
  }
  return file;
}

absl::StatusOr<TemporaryFile> TemporaryFile::Create(const std::string& folder) {
  for (;;) {
    std::string path = absl::StrCat(folder, "/", RandomFileName());
    FileDescriptor file(Retry([&] { return open(path.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, kFileMode); }));
    if (!file.IsOpen()) {
      if (errno == EEXIST) continue;
      return CreationError(errno, "create", path);
    }
    TemporaryFile temporary(std::move(file), std::move(path));
    if (Retry([&] { return flock(temporary.file_.get(), LOCK_EX | LOCK_NB); }) != 0 && errno == EWOULDBLOCK) continue;
    // A server that is just being started may have taken the file for an abandoned one before it was locked.
    struct stat status;
    if (fstat(temporary.file_.get(), &status) != 0) return FileError(errno, "examine", temporary.path_);
    if (status.st_nlink != 0) return temporary;
  }
}

TemporaryFile::TemporaryFile(TemporaryFile&& other) noexcept
    : file_(std::move(other.file_)), path_(std::exchange(other.path_, {})) {}

TemporaryFile::~TemporaryFile() {
  if (!path_.empty()) unlink(path_.c_str());
}

absl::Status TemporaryFile::Sync() {
  if (Retry([&] { return fsync(file_.get()); }) != 0) return FileError(errno, "sync", path_);
  return absl::OkStatus();
}

absl::Status TemporaryFile::MoveTo(const std::string& path) {
  if (rename(path_.c_str(), path.c_str()) != 0) return FileError(errno, "rename a temporary to", path);
  path_.clear();
  return SyncFolderOf(path);
}

absl::StatusOr<FileDescriptor> TemporaryFile::TakeUnnamed() && {
  if (unlink(path_.c_str()) != 0 && errno != ENOENT) return FileError(errno, "remove", path_);
  path_.clear();
  return std::move(file_);
}

absl::StatusOr<FileDescriptor> CreateUnnamedFile(const std::string& folder) {
  FileDescriptor file(Retry([&] { return open(folder.c_str(), O_TMPFILE | O_EXCL | O_RDWR | O_CLOEXEC, kFileMode); }));
  if (file.IsOpen()) return file;
  // NFS, FUSE and others have no O_TMPFILE.
  if (errno != EOPNOTSUPP && errno != EISDIR && errno != EINVAL) {
    return CreationError(errno, "create a file in", absl::StrCat(folder, "/"));
  }
  absl::StatusOr<TemporaryFile> temporary = TemporaryFile::Create(folder);
  if (!temporary.ok()) return temporary.status();
  return std::move(*temporary).TakeUnnamed();
}

size_t RemoveAbandonedFiles(const std::string& folder) {
  size_t removed = 0;
  std::error_code error;
  for (std::filesystem::directory_iterator entry(folder, error), end; !error && entry != end; entry.increment(error)) {
    const std::string path = entry->path().string();
    const FileDescriptor file(
        Retry([&] { return open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOFOLLOW); }));
    if (!file.IsOpen() || !IsAbandoned(file.get())) continue;
    if (unlink(path.c_str()) == 0) {
      ++removed;
    } else if (errno != ENOENT) {
      spdlog::warn("cannot remove the abandoned file {}: {}", absl::CHexEscape(path),
                   std::generic_category().message(errno));
    }
  }
  if (error) spdlog::warn("cannot list {}: {}", folder, error.message());
  return removed;
}

}  // namespace deltaray
