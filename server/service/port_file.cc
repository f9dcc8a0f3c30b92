#include "server/service/port_file.h"

#include <signal.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <system_error>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

namespace deltaray {
namespace {

absl::Status CannotWritePort(const std::string& path) {
  return absl::UnknownError(absl::StrCat("--port-file: cannot write ", path, ": ", std::strerror(errno)));
}

absl::Status WriteAndClosePort(std::FILE* file, const std::string& path, int port) {
  if (file == nullptr) return CannotWritePort(path);
  const bool written = std::fprintf(file, "%d\n", port) > 0;
  return std::fclose(file) == 0 && written ? absl::OkStatus() : CannotWritePort(path);
}

// As fopen, but signals that the caller blocks can end the process while this waits for a pipe's reader.
// What the file holds already stays: it may be the server's own output.
std::FILE* OpenInterruptibly(const std::string& path) {
  sigset_t none, before;
  sigemptyset(&none);
  pthread_sigmask(SIG_SETMASK, &none, &before);
  std::FILE* const file = std::fopen(path.c_str(), "ae");
  const int error = errno;
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  errno = error;
  return file;
}

// Whether the path is of an open file, such as /dev/stdout and /dev/fd/3, which somebody holds and reads: not to be
// replaced, whatever it is.
bool IsOpenFile(const std::filesystem::path& path) {
  std::error_code error;
  const std::string text = std::filesystem::absolute(path, error).lexically_normal().string();
  if (absl::StartsWith(text, "/dev/shm/")) return false;
  return absl::StartsWith(text, "/dev/") || absl::StartsWith(text, "/proc/");
}

}  // namespace

absl::Status WritePortFile(const std::string& path, int port) {
  std::error_code error;
  const bool exists = std::filesystem::exists(path, error);
  const std::string target = exists ? std::filesystem::canonical(path, error).string() : path;
  if (exists && (error || IsOpenFile(path) || !std::filesystem::is_regular_file(target, error))) {
    return WriteAndClosePort(OpenInterruptibly(path), path, port);
  }
  const std::string beside = absl::StrCat(target, ".", getpid(), ".tmp");
  // In a container a server that died before had the same number.
  unlink(beside.c_str());
  absl::Status status = WriteAndClosePort(std::fopen(beside.c_str(), "wxe"), path, port);
  if (status.ok() && std::rename(beside.c_str(), target.c_str()) != 0) status = CannotWritePort(path);
  if (!status.ok()) unlink(beside.c_str());
  return status;
}

}  // namespace deltaray
