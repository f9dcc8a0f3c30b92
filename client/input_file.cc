#include "client/input_file.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/exit_code.h"

namespace deltaray {
namespace {

absl::Status SystemError(absl::string_view what, absl::string_view name) {
  return LocalError(absl::StrCat("cannot ", what, " ", name, ": ", std::strerror(errno)));
}

}  // namespace

absl::StatusOr<InputFile> InputFile::Open(const std::string& path, const Session& session) {
  if (path == "-") return InputFile(session.input_fd, /*owned=*/false, "standard input", session.stop);
  // Opening a FIFO waits for a writer; with O_NONBLOCK it does not, and poll waits instead.
  const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (fd < 0) return SystemError("open", path);
  InputFile file(fd, /*owned=*/true, path, session.stop);
  struct stat info;
  if (fstat(fd, &info) != 0) return SystemError("read", path);
  if (S_ISDIR(info.st_mode)) return LocalError(absl::StrCat("cannot read ", path, ": it is a directory"));
  if (S_ISREG(info.st_mode)) file.size_ = info.st_size;
  return file;
}

InputFile::InputFile(int fd, bool owned, std::string name, const StopSignal& stop)
    : fd_(fd), owned_(owned), name_(std::move(name)), stop_(&stop) {}

InputFile::InputFile(InputFile&& other) noexcept
    : fd_(other.fd_),
      owned_(std::exchange(other.owned_, false)),
      name_(std::move(other.name_)),
      size_(other.size_),
      stop_(other.stop_) {}

InputFile::~InputFile() {
  if (owned_) close(fd_);
}

absl::StatusOr<size_t> InputFile::ReadSome(std::span<char> buffer) {
  while (true) {
    std::array<pollfd, 2> polled = {{{fd_, POLLIN, 0}, {stop_->fd(), POLLIN, 0}}};
    if (poll(polled.data(), polled.size(), -1) < 0 && errno != EINTR) return SystemError("wait for", name_);
    if (stop_->fired()) return Interrupted();
    if (polled[0].revents == 0) continue;
    const ssize_t count = read(fd_, buffer.data(), buffer.size());
    if (count >= 0) return static_cast<size_t>(count);
    if (errno != EINTR && errno != EAGAIN) return SystemError("read", name_);
  }
}

absl::StatusOr<size_t> InputFile::Read(std::span<char> buffer) {
  size_t filled = 0;
  while (filled < buffer.size()) {
    const absl::StatusOr<size_t> count = ReadSome(buffer.subspan(filled));
    if (!count.ok()) return count.status();
    if (*count == 0) break;
    filled += *count;
  }
  return filled;
}

absl::Status InputFile::Rewind() {
  if (lseek(fd_, 0, SEEK_SET) != 0) return SystemError("rewind", name_);
  return absl::OkStatus();
}

}  // namespace deltaray
