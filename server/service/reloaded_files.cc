#include "server/service/reloaded_files.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

constexpr std::chrono::milliseconds kReloadInterval{500};
// Far more than certificates and tokens take; a wrong path may lead to a file without end.
constexpr size_t kMaxBytes = size_t{4} << 20;

absl::Status ReadWhole(ReloadedFile& file) {
  file.bytes.clear();
  // Without O_NONBLOCK a FIFO would block whoever opens it.
  const int descriptor = open(file.path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (descriptor < 0) return file.Error(strerror(errno));
  const std::unique_ptr<FILE, int (*)(FILE*)> stream(fdopen(descriptor, "rb"), fclose);
  if (stream == nullptr) {
    const absl::Status status = file.Error(strerror(errno));
    close(descriptor);
    return status;
  }
  struct stat status;
  if (fstat(descriptor, &status) != 0) return file.Error(strerror(errno));
  if (!S_ISREG(status.st_mode)) return file.Error("is not a regular file");
  std::array<char, 8192> piece;
  while (const size_t count = fread(piece.data(), 1, piece.size(), stream.get())) {
    file.bytes.append(piece.data(), count);
    if (file.bytes.size() > kMaxBytes) return file.Error(absl::StrCat("has more than ", kMaxBytes, " bytes"));
  }
  return ferror(stream.get()) != 0 ? file.Error(strerror(errno)) : absl::OkStatus();
}

absl::Status ReadAll(std::vector<ReloadedFile>& files) {
  for (ReloadedFile& file : files) {
    if (absl::Status status = ReadWhole(file); !status.ok()) return status;
  }
  return absl::OkStatus();
}

bool SameBytes(const std::vector<ReloadedFile>& a, const std::vector<ReloadedFile>& b) {
  return std::ranges::equal(a, b, {}, &ReloadedFile::bytes, &ReloadedFile::bytes);
}

}  // namespace

absl::Status ReloadedFile::Error(absl::string_view what) const {
  return absl::InvalidArgumentError(absl::StrCat("--", flag, ": ", path, ": ", what));
}

absl::StatusOr<std::unique_ptr<ReloadedFiles>> ReloadedFiles::Start(std::vector<ReloadedFile> files, Load load) {
  if (absl::Status status = ReadAll(files); !status.ok()) return status;
  if (absl::Status status = load(files); !status.ok()) return status;
  std::unique_ptr<ReloadedFiles> reloaded(new ReloadedFiles(std::move(files), std::move(load)));
  reloaded->thread_ = std::thread([self = reloaded.get()] { self->Watch(); });
  return reloaded;
}

ReloadedFiles::~ReloadedFiles() {
  {
    MutexLock lock(mutex_);
    ending_ = true;
  }
  ending_changed_.notify_all();
  if (thread_.joinable()) thread_.join();
}

void ReloadedFiles::Watch() {
  std::vector<ReloadedFile> look = files_, last = files_;
  std::string last_error;  // logged once, not at every look
  const std::string names =
      absl::StrJoin(files_, ", ", [](std::string* out, const ReloadedFile& file) { out->append(file.path); });
  while (true) {
    {
      MutexLock lock(mutex_);
      if (!ending_) ending_changed_.wait_for(mutex_, kReloadInterval);
      if (ending_) return;
    }
    absl::Status status = ReadAll(look);
    if (status.ok()) {
      const bool settled = SameBytes(look, last);
      last = look;
      if (!settled) continue;
      if (SameBytes(look, files_)) {
        last_error.clear();
        continue;
      }
      files_ = look;
      status = load_(files_);
      if (status.ok()) spdlog::info("read again, as they changed: {}", names);
    }
    if (!status.ok() && status.message() != last_error) {
      spdlog::error("what was read before stays in use: {}", std::string(status.message()));
      last_error = std::string(status.message());
    }
  }
}

}  // namespace deltaray
