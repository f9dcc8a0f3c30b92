#include "client/output_file.h"

#include <cerrno>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "client/exit_code.h"

namespace deltaray {
namespace {

absl::Status CannotWrite(absl::string_view name) {
  if (errno == EPIPE) return OutputClosed();
  return LocalError(absl::StrCat("cannot write ", name, ": ", std::strerror(errno)));
}

}  // namespace

absl::Status WriteOutput(std::FILE* file, absl::string_view data, absl::string_view name) {
  if (std::fwrite(data.data(), 1, data.size(), file) != data.size() || std::fflush(file) != 0) {
    return CannotWrite(name);
  }
  return absl::OkStatus();
}

absl::Status WriteWholeFile(const std::string& path, absl::string_view data) {
  std::FILE* file = std::fopen(path.c_str(), "wbe");
  if (file == nullptr) return CannotWrite(path);
  absl::Status status = WriteOutput(file, data, path);
  if (std::fclose(file) != 0) status.Update(CannotWrite(path));
  return status;
}

}  // namespace deltaray
