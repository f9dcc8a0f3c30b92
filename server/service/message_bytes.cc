#include "server/service/message_bytes.h"

#include <new>

#include "absl/strings/str_cat.h"
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

grpc::ByteBuffer SerializeMessage(const google::protobuf::MessageLite& message) {
  grpc::ByteBuffer bytes;
  bool own;
  const grpc::Status status = Traits::Serialize(message, &bytes, &own);
  if (!status.ok()) throw std::bad_alloc();
  return bytes;
}

}  // namespace deltaray
