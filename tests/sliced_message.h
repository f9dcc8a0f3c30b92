// Messages in slices, as gRPC hands them over.

#ifndef TESTS_SLICED_MESSAGE_H_
#define TESTS_SLICED_MESSAGE_H_

#include <string>
#include <vector>

#include "grpcpp/support/byte_buffer.h"
#include "server/service/ray_message.h"

namespace deltaray {

// `bytes` in slices of `size` bytes.
inline grpc::ByteBuffer InSlices(const std::string& bytes, size_t size) {
  std::vector<grpc::Slice> slices;
  for (size_t i = 0; i < bytes.size(); i += size) slices.emplace_back(bytes.substr(i, size));
  return {slices.data(), slices.size()};
}

// The bytes of a part of a message.
inline std::string Read(const MessageSlices& message, MessageRange range) {
  std::string scratch(range.size, '\0');
  return {message.Read(range.offset, range.size, scratch.data()), range.size};
}

}  // namespace deltaray

#endif  // TESTS_SLICED_MESSAGE_H_
