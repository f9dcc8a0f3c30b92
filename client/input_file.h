// Reading a file, a pipe or standard input, so that a stop of the program ends a read that waits.

#ifndef CLIENT_INPUT_FILE_H_
#define CLIENT_INPUT_FILE_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/session.h"

namespace deltaray {

class InputFile {
 public:
  // Opens a path, or standard input for "-". The session must outlive the file.
  static absl::StatusOr<InputFile> Open(const std::string& path, const Session& session);

  InputFile(InputFile&& other) noexcept;
  InputFile& operator=(InputFile&&) = delete;
  ~InputFile();

  // The path, or "standard input", for texts.
  const std::string& name() const { return name_; }

  // Size in bytes of a regular file that was given by its path; nullopt for all else.
  std::optional<uint64_t> size() const { return size_; }

  // Reads until `buffer` is full or the file ends; returns the number of bytes. Fails once the program is stopped.
  absl::StatusOr<size_t> Read(std::span<char> buffer);

  // As Read, but returns as soon as there is at least one byte; 0 at the end of the file.
  absl::StatusOr<size_t> ReadSome(std::span<char> buffer);

  // Goes back to the first byte. Only where size() is set.
  absl::Status Rewind();

 private:
  InputFile(int fd, bool owned, std::string name, const StopSignal& stop);

  int fd_;
  bool owned_;
  std::string name_;
  std::optional<uint64_t> size_;
  const StopSignal* stop_;
};

}  // namespace deltaray

#endif  // CLIENT_INPUT_FILE_H_
