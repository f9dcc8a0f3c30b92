// The bytes of an upload, on disk under no name.

#ifndef SERVER_STORE_UPLOAD_FILE_H_
#define SERVER_STORE_UPLOAD_FILE_H_

#include <cstdint>
#include <functional>
#include <span>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/store/disk_budget.h"
#include "server/store/durable_file.h"
#include "server/store/sha256.h"

namespace deltaray {

// The file has no name, so that nothing of it outlives the server, and costs disk instead of memory. Not thread-safe.
class UploadFile {
 public:
  // RESOURCE_EXHAUSTED, later, for what is longer than `max_bytes` or more than `budget` has room for.
  static absl::StatusOr<UploadFile> Create(const std::string& folder, uint64_t max_bytes, DiskBudget* budget);

  // After an error the file is of no use any more; Finish returns that error again.
  absl::Status Append(absl::string_view bytes);
  uint64_t size() const { return size_; }

  // The SHA-256 of all bytes, 32 bytes. REQUIRES: called once, after the last Append.
  absl::StatusOr<std::string> Finish();
  // Calls `read` with all bytes, which are gone once it returns.
  absl::Status Read(const std::function<absl::Status(std::span<const char>)>& read) const;

 private:
  UploadFile(FileDescriptor file, std::string folder, uint64_t max_bytes, DiskBudget* budget)
      : charge_(budget), file_(std::move(file)), folder_(std::move(folder)), max_bytes_(max_bytes) {}

  DiskBudget::Charge charge_;
  FileDescriptor file_;
  std::string folder_;
  uint64_t max_bytes_;
  uint64_t size_ = 0;
  Sha256 sha256_;
  absl::Status status_;
};

}  // namespace deltaray

#endif  // SERVER_STORE_UPLOAD_FILE_H_
