#include "server/service/message_bytes.h"

#include <new>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "google/protobuf/io/coded_stream.h"
#include "grpcpp/impl/codegen/proto_utils.h"

namespace deltaray {
namespace {
using Traits = grpc::SerializationTraits<google::protobuf::MessageLite>;
}  // namespace

absl::Status ParseMessage(grpc::ByteBuffer bytes, google::protobuf::MessageLite* message) {
  const size_t size = bytes.Length();
  if (Traits::Deserialize(&bytes, message).ok()) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("malformed message: these ", size, " bytes are not a ", message->GetTypeName()));
}

absl::Status ParseSmallMessage(grpc::ByteBuffer bytes, google::protobuf::MessageLite* message) {
  if (absl::Status status = CheckSmall(bytes.Length(), message->GetTypeName()); !status.ok()) return status;
  return ParseMessage(std::move(bytes), message);
}

absl::Status CheckSmall(size_t bytes, absl::string_view what) {
  if (bytes <= kMaxSmallMessageBytes) return absl::OkStatus();
  return absl::ResourceExhaustedError(
      absl::StrCat(what, " takes more than ", kMaxSmallMessageBytes, " bytes besides rays and files"));
}

grpc::ByteBuffer SerializeMessage(const google::protobuf::MessageLite& message) {
  grpc::ByteBuffer bytes;
  bool own;
  const grpc::Status status = Traits::Serialize(message, &bytes, &own);
  if (!status.ok()) throw std::bad_alloc();
  return bytes;
}

grpc::ByteBuffer SerializeMessage(const google::protobuf::MessageLite& message, int number, grpc::Slice value) {
  // Fields may stand in any order, those of `message` first, and the value, which may be large, shares its memory.
  std::string before = message.SerializeAsString();
  constexpr int kLengthDelimited = 2;
  before.push_back(static_cast<char>(number << 3 | kLengthDelimited));
  uint8_t length[10];
  uint8_t* const end = google::protobuf::io::CodedOutputStream::WriteVarint64ToArray(value.size(), length);
  before.insert(before.end(), length, end);
  const grpc::Slice slices[] = {grpc::Slice(before), std::move(value)};
  return {slices, 2};
}

absl::StatusOr<grpc::ByteBuffer> SerializeReply(const google::protobuf::MessageLite& message, uint64_t max_bytes) {
  if (const size_t size = message.ByteSizeLong(); size > max_bytes) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the reply of ", size, " bytes is over the limit of ", max_bytes, " bytes a message"));
  }
  return SerializeMessage(message);
}

}  // namespace deltaray
