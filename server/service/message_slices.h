// The bytes of a message as gRPC holds them.

#ifndef SERVER_SERVICE_MESSAGE_SLICES_H_
#define SERVER_SERVICE_MESSAGE_SLICES_H_

#include <cstddef>
#include <vector>

#include "grpcpp/support/byte_buffer.h"
#include "grpcpp/support/slice.h"

namespace deltaray {

// A large message arrives in slices, one a frame of HTTP/2. This reads across them without putting them together.
// Thread-safe while nobody moves it.
class MessageSlices {
 public:
  MessageSlices() = default;
  // Shares the memory of `bytes`.
  explicit MessageSlices(const grpc::ByteBuffer& bytes);
  explicit MessageSlices(grpc::Slice slice);
  MessageSlices(const MessageSlices&) = default;
  MessageSlices(MessageSlices&&) = default;
  MessageSlices& operator=(MessageSlices other) noexcept;

  size_t size() const { return size_; }

  // The `size` bytes at `offset`: where they lie, or where a slice ends among them as a copy in `scratch`, which has
  // room for them. REQUIRES: offset + size <= size().
  const char* Read(size_t offset, size_t size, char* scratch) const;

 private:
  // Goes last: gRPC 1.51 gives memory back to its quota when the last holder of a slice goes, and crashes where that
  // wakes up what waits for memory and the thread is not one of its own. A ByteBuffer provides for that, a Slice does
  // not.
  grpc::ByteBuffer owner_;
  std::vector<grpc::Slice> slices_;
  std::vector<size_t> starts_;  // offset of the first byte of each slice
  size_t size_ = 0;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_MESSAGE_SLICES_H_
