#include "server/store/upload_file.h"

#include <sys/mman.h>

#include <cerrno>
#include <utility>

#include "absl/strings/str_cat.h"

namespace deltaray {

absl::StatusOr<UploadFile> UploadFile::Create(const std::string& folder, uint64_t max_bytes, DiskBudget* budget) {
  absl::StatusOr<FileDescriptor> file = CreateUnnamedFile(folder);
  if (!file.ok()) return file.status();
  return UploadFile(*std::move(file), folder, max_bytes, budget);
}

absl::Status UploadFile::Append(absl::string_view bytes) {
  if (!status_.ok()) return status_;
  if (bytes.size() > max_bytes_ - size_) {
    status_ = absl::ResourceExhaustedError(
        absl::StrCat("the upload is over the limit of ", max_bytes_, " bytes (--max-upload-bytes)"));
    return status_;
  }
  status_ = charge_.Add(bytes.size());
  if (!status_.ok()) return status_;
  status_ = WriteAll(file_, bytes, folder_);
  if (!status_.ok()) return status_;
  sha256_.Update(bytes);
  size_ += bytes.size();
  return absl::OkStatus();
}

absl::StatusOr<std::string> UploadFile::Finish() {
  if (!status_.ok()) return status_;
  return sha256_.Finish();
}

absl::Status UploadFile::Read(const std::function<absl::Status(std::span<const char>)>& read) const {
  if (size_ == 0) return read({});
  // Nobody else can reach the file to cut it short, so that it is safe to map.
  void* const address = mmap(nullptr, size_, PROT_READ, MAP_PRIVATE, file_.get(), 0);
  if (address == MAP_FAILED) return FileError(errno, "map an upload in", folder_);
  madvise(address, size_, MADV_SEQUENTIAL);
  const absl::Status status = read({static_cast<const char*>(address), size_});
  munmap(address, size_);
  return status;
}

}  // namespace deltaray
