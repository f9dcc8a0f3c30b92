// Files that are there whole or not at all, whenever the machine stops.
//
// A file is written under a random name in a folder for temporaries, synced, renamed to its place, and the folder of
// its place is synced. A temporary is locked (flock) for as long as its writer lives, so that any server that opens the
// data directory can tell what a dead one left behind, also where several share it.
//
// Errors of the system: RESOURCE_EXHAUSTED where the disk or a quota is full or descriptors run out,
// FAILED_PRECONDITION where the place may not be written to, NOT_FOUND where there is no such file, else INTERNAL. All
// texts name the file.

#ifndef SERVER_STORE_DURABLE_FILE_H_
#define SERVER_STORE_DURABLE_FILE_H_

#include <chrono>
#include <cstdint>
#include <span>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace deltaray {

// Owns an open file. Moves, does not copy.
class FileDescriptor {
 public:
  explicit FileDescriptor(int fd = -1) : fd_(fd) {}
  FileDescriptor(FileDescriptor&& other) noexcept : fd_(other.Release()) {}
  FileDescriptor& operator=(FileDescriptor&& other) noexcept;
  ~FileDescriptor();

  int get() const { return fd_; }
  bool IsOpen() const { return fd_ >= 0; }

 private:
  int Release() {
    const int fd = fd_;
    fd_ = -1;
    return fd;
  }
  int fd_;
};

// The error `error` (an errno) of doing `action`, such as "write", to `path`. A file that its folder lacks is
// NOT_FOUND; where the folder itself is gone, as the volume that it lies in may be, it is not known what there is:
// FAILED_PRECONDITION.
absl::Status FileError(int error, absl::string_view action, absl::string_view path);

// The same of a folder that should be there.
absl::Status FolderError(int error, absl::string_view action, const std::string& path);

absl::StatusOr<FileDescriptor> OpenToRead(const std::string& path);
absl::StatusOr<uint64_t> FileSize(const FileDescriptor& file, const std::string& path);
// Fills `bytes` from `offset`. DATA_LOSS where the file ends before.
absl::Status ReadAt(const FileDescriptor& file, uint64_t offset, std::span<char> bytes, const std::string& path);
// The content of a file of at most `limit` bytes; DATA_LOSS where it has more.
absl::StatusOr<std::string> ReadSmallFile(const std::string& path, uint64_t limit);

absl::Status WriteAll(const FileDescriptor& file, absl::string_view bytes, const std::string& path);

// Makes the folder, and those above it, where missing. It is there, durably, once this returns.
absl::Status MakeFolder(const std::string& path);
// Makes what was made, renamed and removed in the folder durable.
absl::Status SyncFolder(const std::string& path);
// The same for the folder that the file lies in.
absl::Status SyncFolderOf(const std::string& path);
// Removes a file and makes that durable. OK where there is none: that is made durable too, since whoever removed it may
// have failed to.
absl::Status RemoveFile(const std::string& path);
// The same for files of `folder`, at the cost of one.
absl::Status RemoveFiles(const std::string& folder, std::span<const std::string> paths);

// Whether files may be made and removed in the folder, as far as its permissions and its file system tell: a full disk
// is not noticed. Errors as above. Makes no file and needs no descriptor.
absl::Status CheckWritable(const std::string& path);
// Whether LockFile may open the file or, where it is missing, make it. Errors as above.
absl::Status CheckLockable(const std::string& path);

// Takes the lock of a file, which is made where missing and never removed. The lock goes with the descriptor, so with
// the server too, whatever happens to it. UNAVAILABLE where somebody else has it for longer than `timeout`. Where the
// file system has no locks, all get it.
absl::StatusOr<FileDescriptor> LockFile(const std::string& path, std::chrono::milliseconds timeout);

// A file on its way to its place. What was not moved there is removed by the destructor. Not thread-safe.
class TemporaryFile {
 public:
  // `folder` must lie in the same file system as the file's place.
  static absl::StatusOr<TemporaryFile> Create(const std::string& folder);
  TemporaryFile(TemporaryFile&& other) noexcept;
  TemporaryFile& operator=(TemporaryFile&& other) = delete;
  ~TemporaryFile();

  absl::Status Append(absl::string_view bytes) { return WriteAll(file_, bytes, path_); }
  // Makes the content durable. REQUIRES: called before MoveTo.
  absl::Status Sync();
  // Moves the file to `path`, in place of what may be there. After an error either may be there.
  absl::Status MoveTo(const std::string& path);
  // Takes the name away, and gives the file, still locked: a network file system may keep an open file under a name.
  absl::StatusOr<FileDescriptor> TakeUnnamed() &&;

 private:
  TemporaryFile(FileDescriptor file, std::string path) : file_(std::move(file)), path_(std::move(path)) {}

  FileDescriptor file_;
  std::string path_;  // empty once moved
};

// A file without a name in `folder`, to write and read: gone with its descriptor, whatever happens to the server.
absl::StatusOr<FileDescriptor> CreateUnnamedFile(const std::string& folder);

// Removes the temporaries in `folder` whose writers are gone. Where the file system has no locks, those older than a
// day. Returns how many were removed; errors are logged.
size_t RemoveAbandonedFiles(const std::string& folder);

}  // namespace deltaray

#endif  // SERVER_STORE_DURABLE_FILE_H_
