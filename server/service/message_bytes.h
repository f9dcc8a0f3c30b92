// Messages as the bytes that gRPC carries.
//
// The handlers take raw bytes and parse them here, since gRPC 1.51 answers a malformed unary request with UNIMPLEMENTED
// and takes a malformed message of a stream for its end.

#ifndef SERVER_SERVICE_MESSAGE_BYTES_H_
#define SERVER_SERVICE_MESSAGE_BYTES_H_

#include <cstddef>
#include <cstdint>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "google/protobuf/message_lite.h"
#include "grpcpp/support/byte_buffer.h"
#include "grpcpp/support/slice.h"

namespace deltaray {

// Parses `bytes` and lets go of them. INVALID_ARGUMENT where they are no such message.
absl::Status ParseMessage(grpc::ByteBuffer bytes, google::protobuf::MessageLite* message);

// What a message may take besides rays and bytes of files. Parsed, a message of hostile fields takes some 25 times as
// much as on the wire.
inline constexpr size_t kMaxSmallMessageBytes = 64 << 10;

// ParseMessage for messages without such arrays: RESOURCE_EXHAUSTED where one takes more than kMaxSmallMessageBytes.
absl::Status ParseSmallMessage(grpc::ByteBuffer bytes, google::protobuf::MessageLite* message);
// RESOURCE_EXHAUSTED: `what`, of `bytes`, is over kMaxSmallMessageBytes.
absl::Status CheckSmall(size_t bytes, absl::string_view what);

// REQUIRES: the message takes less than 2 GiB.
grpc::ByteBuffer SerializeMessage(const google::protobuf::MessageLite& message);

// The message that has all fields of `message`, and `value`, a message in its bytes, as its field `number`, below 16.
grpc::ByteBuffer SerializeMessage(const google::protobuf::MessageLite& message, int number, grpc::Slice value);
// RESOURCE_EXHAUSTED where the message takes more than `max_bytes`, which clients need not be ready to receive.
absl::StatusOr<grpc::ByteBuffer> SerializeReply(const google::protobuf::MessageLite& message, uint64_t max_bytes);

}  // namespace deltaray

#endif  // SERVER_SERVICE_MESSAGE_BYTES_H_
