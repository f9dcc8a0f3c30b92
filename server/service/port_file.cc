#include "server/service/port_file.h"

#include <fcntl.h>
#include <signal.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <system_error>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "absl/strings/strip.h"

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
std::FILE* OpenInterruptibly(const std::string& path) {
  sigset_t none, before;
  sigemptyset(&none);
  pthread_sigmask(SIG_SETMASK, &none, &before);
  std::FILE* const file = std::fopen(path.c_str(), "we");
  const int error = errno;
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  errno = error;
  return file;
}

// The open file of this process that the path is of, as /dev/stdout and /dev/fd/3 are; -1: of none.
int OpenFileOf(const std::filesystem::path& path) {
  std::error_code error;
  const std::string text = std::filesystem::absolute(path, error).lexically_normal().string();
  if (text == "/dev/stdout") return STDOUT_FILENO;
  if (text == "/dev/stderr") return STDERR_FILENO;
  absl::string_view number = text;
  int file = -1;
  const bool is_number = (absl::ConsumePrefix(&number, "/dev/fd/") || absl::ConsumePrefix(&number, "/proc/self/fd/")) &&
                         absl::SimpleAtoi(number, &file);
  return is_number ? file : -1;
}

}  // namespace

absl::Status WritePortFile(const std::string& path, int port) {
  std::error_code error;
  const bool exists = std::filesystem::exists(path, error);
  const std::string target = exists ? std::filesystem::canonical(path, error).string() : path;
  // Not opened anew: that would begin at an offset of its own, and what is written after it overwrite it.
  if (const int open_file = OpenFileOf(path); exists && open_file >= 0) {
    const int copy = fcntl(open_file, F_DUPFD_CLOEXEC, 0);
    return WriteAndClosePort(copy < 0 ? nullptr : fdopen(copy, "w"), path, port);
  }
  if (exists && (error || !std::filesystem::is_regular_file(target, error))) {
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
