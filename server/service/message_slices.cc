#include "server/service/message_slices.h"

#include <algorithm>
#include <cstring>
#include <utility>

namespace deltaray {

MessageSlices::MessageSlices(const grpc::ByteBuffer& bytes) : owner_(bytes) {
  // Fails for compressed messages alone, which the server refuses.
  if (!bytes.Valid() || !bytes.Dump(&slices_).ok()) return;
  starts_.reserve(slices_.size());
  for (const grpc::Slice& slice : slices_) {
    starts_.push_back(size_);
    size_ += slice.size();
  }
}

MessageSlices::MessageSlices(grpc::Slice slice) : starts_{0}, size_(slice.size()) {
  slices_.push_back(std::move(slice));
}

MessageSlices& MessageSlices::operator=(MessageSlices other) noexcept {
  owner_.Swap(&other.owner_);
  slices_.swap(other.slices_);
  starts_.swap(other.starts_);
  std::swap(size_, other.size_);
  return *this;
}

const char* MessageSlices::Read(size_t offset, size_t size, char* scratch) const {
  if (size == 0) return scratch;
  size_t i = std::upper_bound(starts_.begin(), starts_.end(), offset) - starts_.begin() - 1;
  size_t within = offset - starts_[i];
  const auto bytes = [this](size_t slice) { return reinterpret_cast<const char*>(slices_[slice].begin()); };
  if (within + size <= slices_[i].size()) return bytes(i) + within;
  for (size_t done = 0; done < size; ++i, within = 0) {
    const size_t part = std::min(size - done, slices_[i].size() - within);
    std::memcpy(scratch + done, bytes(i) + within, part);
    done += part;
  }
  return scratch;
}

}  // namespace deltaray
