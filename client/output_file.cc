#include "client/output_file.h"

#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "client/exit_code.h"

namespace deltaray {
namespace {

absl::Status CannotWrite(absl::string_view name) {
  if (errno == EPIPE) return OutputClosed();
  return LocalError(absl::StrCat("cannot write ", name, ": ", std::strerror(errno)));
}

absl::Status WriteAndClose(std::FILE* file, absl::string_view data, const std::string& path) {
  if (file == nullptr) return CannotWrite(path);
  absl::Status status = WriteOutput(file, data, path);
  if (std::fclose(file) != 0) status.Update(CannotWrite(path));
  return status;
}

}  // namespace

absl::Status WriteOutput(std::FILE* file, absl::string_view data, absl::string_view name) {
  if (std::fwrite(data.data(), 1, data.size(), file) != data.size() || std::fflush(file) != 0) {
    return CannotWrite(name);
  }
  return absl::OkStatus();
}

absl::Status WriteWholeFile(const std::string& path, absl::string_view data) {
  struct stat old;
  const bool exists = stat(path.c_str(), &old) == 0;
  std::error_code error;
  // A symbolic link stays, and leads to the new file.
  const std::string target = exists ? std::filesystem::canonical(path, error).string() : path;
  if (exists && (error || !S_ISREG(old.st_mode))) return WriteAndClose(std::fopen(path.c_str(), "wbe"), data, path);
  // The rename would not ask whether the old file may be written.
  if (exists && access(path.c_str(), W_OK) != 0) return CannotWrite(path);

  const std::string beside = absl::StrCat(target, ".", getpid(), ".tmp");
  std::FILE* const file = std::fopen(beside.c_str(), "wbxe");
  if (file == nullptr) return CannotWrite(path);
  absl::Status status = WriteAndClose(file, data, path);
  if (status.ok()) {
    if (exists) chmod(beside.c_str(), old.st_mode & 07777);
    if (std::rename(beside.c_str(), target.c_str()) != 0) status = CannotWrite(path);
  }
  if (!status.ok()) unlink(beside.c_str());
  return status;
}

}  // namespace deltaray
